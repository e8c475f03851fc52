#include "rewrite.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <unordered_map>
#include <unordered_set>

#include "operators.h"

namespace tt3d::model {

std::vector<int> count_reads(const Graph& graph) {
  std::vector<int> reads(graph.names.size(), 0);
  for (const Step& step : graph.steps) {
    for_each_read(step, [&](Slot slot) { ++reads[static_cast<size_t>(slot)]; });
  }
  ++reads[static_cast<size_t>(graph.output)];
  return reads;
}

int argument_index(const Step& step, const char* name) {
  const auto& arguments = step.op->schema().arguments();
  for (size_t i = 0; i < arguments.size(); ++i) {
    if (arguments[i].name() == name) return static_cast<int>(i);
  }
  return -1;
}

const Input& argument(const Step& step, const char* name) {
  return step.inputs.at(static_cast<size_t>(argument_index(step, name)));
}

bool is_none(const Input& input) {
  return input.kind == Input::Kind::kConstant && input.constant.isNone();
}

std::vector<int64_t> integers(const Input& input) {
  if (input.kind == Input::Kind::kConstant && input.constant.isIntList()) {
    return input.constant.toIntVector();
  }
  std::vector<int64_t> values;
  for (const Input& item : input.items) {
    if (item.kind != Input::Kind::kConstant || !item.constant.isInt()) return {};
    values.push_back(item.constant.toInt());
  }
  return values;
}

bool writes_in_place(const Step& step) {
  const auto& arguments = step.op->schema().arguments();
  return std::any_of(arguments.begin(), arguments.end(), [](const c10::Argument& argument) {
    return argument.alias_info() != nullptr && argument.alias_info()->isWrite();
  });
}

bool is_zero_padding(const Step& step) {
  const bool pads = step.target == "aten::constant_pad_nd" || step.target == "aten::pad";
  if (!pads || argument(step, "self").kind != Input::Kind::kSlot) return false;
  if (step.target == "aten::pad") {
    const Input& mode = argument(step, "mode");
    if (!mode.constant.isString() || mode.constant.toStringRef() != "constant") return false;
  }
  const Input& value = argument(step, "value");
  if (value.kind != Input::Kind::kConstant) return false;
  return value.constant.isNone() ||
         (value.constant.isScalar() && value.constant.toScalar().toDouble() == 0);
}

at::Tensor weight_of(const Graph& graph, const Input& input) {
  if (input.kind != Input::Kind::kSlot) return {};
  const auto found = graph.constants.find(input.slot);
  return found == graph.constants.end() ? at::Tensor() : found->second;
}

namespace {

constexpr double kDefaultEpsilon = 1e-5;

bool is_conv(const Step& step) {
  return step.target == "aten::conv1d" || step.target == "aten::conv2d" ||
         step.target == "aten::conv3d";
}

bool is_conv2d(const Step& step) { return step.target == "aten::conv2d"; }

bool is_batch_norm(const Step& step) {
  return step.target == "aten::batch_norm" ||
         step.target == "aten::_native_batch_norm_legit_no_training";
}

/// Scale and shift per channel of a batch normalisation in evaluation mode, float64; undefined if a
/// statistic is not a one-dimensional float weight.
struct Affine {
  at::Tensor scale, shift;
};

Affine affine_of(const Graph& graph, const Step& norm) {
  const at::Tensor mean = weight_of(graph, argument(norm, "running_mean"));
  const at::Tensor variance = weight_of(graph, argument(norm, "running_var"));
  const Input& gamma_input = argument(norm, "weight");
  const Input& beta_input = argument(norm, "bias");
  const at::Tensor gamma = weight_of(graph, gamma_input), beta = weight_of(graph, beta_input);
  const bool known = mean.defined() && variance.defined() &&
                     (gamma.defined() || is_none(gamma_input)) &&
                     (beta.defined() || is_none(beta_input));
  const Input& eps = argument(norm, "eps");
  if (!known || eps.kind != Input::Kind::kConstant || mean.dim() != 1) return {};
  for (const at::Tensor& tensor : {mean, variance, gamma, beta}) {
    if (tensor.defined() && !tensor.sizes().equals(mean.sizes())) return {};
  }
  const double epsilon = eps.constant.isDouble() ? eps.constant.toDouble() : kDefaultEpsilon;
  at::Tensor scale = (variance.to(at::kDouble) + epsilon).rsqrt();
  if (gamma.defined()) scale = scale * gamma.to(at::kDouble);
  at::Tensor shift = -mean.to(at::kDouble) * scale;
  if (beta.defined()) shift = shift + beta.to(at::kDouble);
  return {scale, shift};
}

Slot add_constant(Graph& graph, const std::string& name, const at::Tensor& tensor) {
  const auto slot = static_cast<Slot>(graph.names.size());
  graph.names.push_back(name);
  graph.constants.emplace(slot, tensor);
  return slot;
}

Input slot_input(Slot slot) {
  Input input;
  input.kind = Input::Kind::kSlot;
  input.slot = slot;
  return input;
}

/// `weight` with every output channel multiplied by its scale. It allocates only the result:
/// temporary copies would leave holes in the heap that add up to the size of the model.
at::Tensor scaled(const at::Tensor& weight, const at::Tensor& scale, at::MemoryFormat format) {
  std::vector<int64_t> shape(static_cast<size_t>(weight.dim()), 1);
  shape[0] = -1;
  const auto layout = weight.dim() == 4 ? format : at::MemoryFormat::Contiguous;
  at::Tensor result = at::empty(weight.sizes(), weight.options(), layout);
  return at::mul_out(result, weight, scale.to(at::kFloat).reshape(shape));
}

/// Folds scale and shift into the convolution; false if its weight does not fit. The old weight is
/// released at once if nothing else reads it, so that folding needs no second copy of the model.
bool fold_into(Graph& graph, Step& conv, const Affine& affine, const std::vector<int>& reads,
               at::MemoryFormat format) {
  const auto weight_index = static_cast<size_t>(argument_index(conv, "weight"));
  const auto bias_index = static_cast<size_t>(argument_index(conv, "bias"));
  const at::Tensor weight = weight_of(graph, conv.inputs[weight_index]);
  const at::Tensor bias = weight_of(graph, conv.inputs[bias_index]);
  const bool known_bias = bias.defined() || is_none(conv.inputs[bias_index]);
  if (!weight.defined() || !known_bias || weight.scalar_type() != at::kFloat || weight.dim() < 3 ||
      weight.size(0) != affine.scale.size(0)) {
    return false;
  }
  at::Tensor shift = affine.shift;
  if (bias.defined()) shift = shift + bias.to(at::kDouble) * affine.scale;
  const std::string& name = conv.name;
  const Slot old = conv.inputs[weight_index].slot;
  if (reads[static_cast<size_t>(old)] == 1) graph.constants.erase(old);
  const at::Tensor folded = scaled(weight, affine.scale, format);
  conv.inputs[weight_index] = slot_input(add_constant(graph, name + ".folded_weight", folded));
  conv.inputs[bias_index] =
      slot_input(add_constant(graph, name + ".folded_bias", shift.to(at::kFloat)));
  return true;
}

/// Makes every reader of slot `from` read `to` instead.
void redirect(Graph& graph, const std::unordered_map<Slot, Slot>& moved) {
  const auto resolve = [&](Slot& slot) {
    const auto found = moved.find(slot);
    if (found != moved.end()) slot = found->second;
  };
  const auto visit = [&](Input& input, const auto& self) -> void {
    if (input.kind == Input::Kind::kSlot) resolve(input.slot);
    for (Input& item : input.items) self(item, self);
  };
  for (Step& step : graph.steps) {
    for (Input& input : step.inputs) visit(input, visit);
  }
  resolve(graph.output);
}

/// Adds pad (left, right, top, bottom) to the convolution's own padding; false if it is not
/// symmetric.
bool add_padding(Step& conv, const std::vector<int64_t>& pad) {
  const bool alike = pad.size() == 4 && pad[0] == pad[1] && pad[2] == pad[3];
  if (!alike || pad[0] < 0 || pad[2] < 0) return false;
  Input& own = conv.inputs[static_cast<size_t>(argument_index(conv, "padding"))];
  std::vector<int64_t> sum = integers(own);
  if (sum.size() == 1) sum.push_back(sum[0]);
  if (sum.size() != 2 || sum[0] < 0 || sum[1] < 0) return false;
  sum[0] += pad[2];
  sum[1] += pad[0];
  own = Input();
  own.constant = sum;
  return true;
}

void drop_unused_constants(Graph& graph) {
  const std::vector<int> reads = count_reads(graph);
  std::erase_if(graph.constants,
                [&](const auto& item) { return reads[static_cast<size_t>(item.first)] == 0; });
}

bool returns_view(const Step& step) {
  const auto& arguments = step.op->schema().arguments();
  return !writes_in_place(step) &&
         std::any_of(arguments.begin(), arguments.end(),
                     [](const auto& argument) { return argument.alias_info() != nullptr; });
}

/// True if a step writes into another value's memory through a view.
bool writes_through_views(const Graph& graph) {
  std::unordered_set<Slot> views;
  for (const Step& step : graph.steps) {
    if (!step.op) continue;
    if (returns_view(step)) {
      for (const Output& output : step.outputs)
        views.insert(output.slots.begin(), output.slots.end());
    }
    bool through = false;
    for_each_read(step.inputs[0], [&](Slot slot) { through |= views.count(slot) != 0; });
    if (through && writes_in_place(step)) return true;
  }
  return false;
}

}  // namespace

int fold_batch_norms(Graph& graph, at::MemoryFormat format) {
  const std::vector<int> reads = count_reads(graph);
  std::unordered_map<Slot, size_t> producer;
  std::unordered_map<Slot, Slot> moved;
  std::unordered_set<size_t> folded;
  for (size_t i = 0; i < graph.steps.size(); ++i) {
    Step& step = graph.steps[i];
    if (!step.op) continue;
    if (is_conv(step)) producer[step.outputs[0].slots[0]] = i;
    if (!is_batch_norm(step) || argument(step, "input").kind != Input::Kind::kSlot) continue;
    const Slot before = argument(step, "input").slot;
    const auto conv = producer.find(before);
    if (conv == producer.end() || reads[static_cast<size_t>(before)] != 1) continue;
    const Affine affine = affine_of(graph, step);
    if (!affine.scale.defined() ||
        !fold_into(graph, graph.steps[conv->second], affine, reads, format)) {
      continue;
    }
    moved[step.outputs[0].slots[0]] = before;
    folded.insert(i);
  }
  redirect(graph, moved);
  size_t index = 0;
  std::erase_if(graph.steps, [&](const Step&) { return folded.count(index++) != 0; });
  drop_unused_constants(graph);
  return static_cast<int>(folded.size());
}

int simplify_batch_norms(Graph& graph) {
  int count = 0;
  for (Step& step : graph.steps) {
    if (!step.op || !is_batch_norm(step)) continue;
    const Input input = argument(step, "input");
    const auto rank = graph.ranks.find(input.slot);
    if (input.kind != Input::Kind::kSlot || rank == graph.ranks.end() || rank->second < 2) continue;
    const Affine affine = affine_of(graph, step);
    if (!affine.scale.defined()) continue;
    std::vector<int64_t> shape(static_cast<size_t>(rank->second) - 1, 1);
    shape[0] = -1;
    const auto constant = [&](const char* suffix, const at::Tensor& values) {
      const at::Tensor tensor = values.to(at::kFloat).reshape(shape);
      return slot_input(add_constant(graph, step.name + suffix, tensor));
    };
    step.op = find_operator("torch.ops.aten.addcmul.default");
    step.target = step.op->schema().name();
    const Input shift = constant(".shift", affine.shift), scale = constant(".scale", affine.scale);
    step.inputs = {shift, input, scale, Input()};
    step.inputs.back().constant = int64_t{1};
    step.outputs.resize(1);
    ++count;
  }
  drop_unused_constants(graph);
  return count;
}

int fold_paddings(Graph& graph) {
  const std::vector<int> reads = count_reads(graph);
  std::unordered_map<Slot, size_t> producer;
  std::unordered_set<size_t> folded;
  for (size_t i = 0; i < graph.steps.size(); ++i) {
    Step& step = graph.steps[i];
    if (!step.op) continue;
    if (is_zero_padding(step)) producer[step.outputs[0].slots[0]] = i;
    if (!is_conv2d(step) || !step.op->schema().overload_name().empty()) continue;
    const auto pad = producer.find(argument(step, "input").slot);
    if (pad == producer.end() || reads[static_cast<size_t>(pad->first)] != 1) continue;
    const Step& before = graph.steps[pad->second];
    if (!add_padding(step, integers(argument(before, "pad")))) continue;
    step.inputs[static_cast<size_t>(argument_index(step, "input"))] = argument(before, "self");
    folded.insert(pad->second);
  }
  size_t index = 0;
  std::erase_if(graph.steps, [&](const Step&) { return folded.count(index++) != 0; });
  return static_cast<int>(folded.size());
}

bool can_use_channels_last(const Graph& graph) {
  return std::any_of(graph.steps.begin(), graph.steps.end(), is_conv2d) &&
         !writes_through_views(graph);
}

void use_channels_last(Graph& graph) {
  for (Step& step : graph.steps) {
    if (step.target == "aten::view" && step.op->schema().overload_name().empty()) {
      step.op = find_operator("torch.ops.aten.reshape.default");
      step.target = "aten::reshape";
    }
    if (!is_conv2d(step)) continue;
    const Input& weight = argument(step, "weight");
    if (weight.kind != Input::Kind::kSlot) continue;
    const auto found = graph.constants.find(weight.slot);
    if (found == graph.constants.end() || found->second.dim() != 4) continue;
    found->second = found->second.contiguous(at::MemoryFormat::ChannelsLast);
  }
}

}  // namespace tt3d::model
