#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <unordered_map>
#include <unordered_set>

#include "graph_reader.h"
#include "malformed.h"
#include "operators.h"
#include "plan_nodes.h"
#include "rewrite.h"

namespace tt3d::model {
namespace {

using Sizes = std::vector<int64_t>;

/// Shapes of all float values, found by running the smallest batch; empty if that fails.
std::unordered_map<Slot, Sizes> find_shapes(const Graph& graph, int64_t memory) {
  std::unordered_map<Slot, Sizes> shapes;
  const at::NoGradGuard none;
  std::vector<c10::IValue> values;
  MemoryMeter meter(memory, false);
  const auto note = [&](Slot slot) {
    const c10::IValue& value = values[static_cast<size_t>(slot)];
    if (!value.isTensor() || !value.toTensor().is_floating_point()) return;
    shapes[slot] = value.toTensor().sizes().vec();
  };
  try {
    StepRunner runner(graph, at::kCPU, values, meter);
    values[static_cast<size_t>(graph.input)] =
        at::zeros({std::max<int64_t>(graph.min_batch, 1), 3, graph.height, graph.width})
            .contiguous(at::MemoryFormat::ChannelsLast);
    note(graph.input);
    for (const Step& step : graph.steps) {
      runner.run(step);
      for (const Output& output : step.outputs) {
        for (const Slot slot : output.slots) note(slot);
      }
    }
  } catch (const Malformed&) {
    return {};
  } catch (const MemoryLimit&) {
    return {};
  }
  return shapes;
}

/// Operators whose result is new memory, never a view of a weight.
bool gives_new_memory(const std::string& target) {
  static const std::unordered_set<std::string> names = {
      "aten::conv2d", "aten::batch_norm", "aten::addcmul", "aten::linear",
      "aten::add",    "aten::mul",        "aten::cat",     "aten::max_pool2d"};
  return names.count(target) != 0;
}

/// The graph without in-place operators, as far as their input is new memory without another
/// reader; false if one remains.
bool make_functional(Graph& graph) {
  const std::vector<int> reads = count_reads(graph);
  std::unordered_set<Slot> fresh;
  for (const Step& step : graph.steps) {
    std::string target = step.target;
    if (target.ends_with('_')) target.pop_back();  // its own input is checked below
    if (!step.op || !gives_new_memory(target)) continue;
    for (const Output& output : step.outputs) {
      fresh.insert(output.slots.begin(), output.slots.end());
    }
  }
  for (Step& step : graph.steps) {
    if (!step.op || !writes_in_place(step)) continue;
    const Input& self = step.inputs[0];
    const auto& schema = step.op->schema();
    std::string name = schema.name();
    if (self.kind != Input::Kind::kSlot || reads[static_cast<size_t>(self.slot)] != 1 ||
        fresh.count(self.slot) == 0 || !name.ends_with('_')) {
      return false;
    }
    name.pop_back();
    const auto found = c10::Dispatcher::singleton().findSchema({name, schema.overload_name()});
    if (!found || found->schema().arguments().size() != schema.arguments().size()) return false;
    step.op = *found;
    step.target = name;
  }
  return true;
}

/// A transformer's only convolution cuts the picture into patches; the rest is its own time.
bool pays_off(const Graph& graph) {
  int64_t convolutions = 0, linear = 0;
  for (const Step& step : graph.steps) {
    convolutions += step.target == "aten::conv2d" ? 1 : 0;
    linear += step.target == "aten::linear" ? 1 : 0;
  }
  return convolutions >= 2 && convolutions > linear;
}

/// Builds the nodes of a plan.
class Compiler {
 public:
  Compiler(const Graph& graph, Precision precision, int64_t memory)
      : graph_(graph),
        precision_(precision),
        shapes_(find_shapes(graph, memory)),
        reads_(count_reads(graph)),
        ends_(graph.steps.size()),
        taken_(graph.steps.size(), false) {
    for (size_t i = 0; i < graph.steps.size(); ++i) {
      for_each_read(graph.steps[i], [&](Slot slot) { reader_[slot] = i; });
      const auto& outputs = graph.steps[i].outputs;
      const bool one = graph.steps[i].op && outputs.size() == 1 && outputs[0].slots.size() == 1;
      if (one) giver_[outputs[0].slots[0]] = i;
    }
    find_gradients();
  }

  std::shared_ptr<const Plan> plan() {
    for (size_t i = 0; i < graph_.steps.size(); ++i) {
      if (!taken_[i]) match(i);
    }
    join_masks();
    auto nodes = in_order();
    find_releases(nodes);
    return std::make_shared<Plan>(graph_, std::move(nodes));
  }

 private:
  /// A compiled node before it is made. It takes the place of its last step.
  struct Candidate {
    std::optional<ConvolutionSpec> convolution;
    std::optional<AffineSpec> affine;
    std::optional<SumSpec> sum;
    std::vector<Slot> reads;
    Slot output = -1;
  };

  void find_gradients() {
    depends_.insert(graph_.input);
    for (const Step& step : graph_.steps) {
      bool depends = false;
      for_each_read(step, [&](Slot slot) { depends |= has_gradient(slot); });
      if (!depends) continue;
      for (const Output& output : step.outputs) {
        depends_.insert(output.slots.begin(), output.slots.end());
      }
    }
  }

  bool has_gradient(Slot slot) const { return depends_.count(slot) != 0; }
  bool is_picture(Slot slot) const {
    const auto found = shapes_.find(slot);
    return found != shapes_.end() && found->second.size() == 4 && graph_.constants.count(slot) == 0;
  }
  bool same_shape(Slot a, Slot b) const {
    return is_picture(a) && is_picture(b) && shapes_.at(a) == shapes_.at(b);
  }

  /// The only step that reads a value; none if several do or the graph gives it.
  std::optional<size_t> only_reader(Slot slot) const {
    const auto found = reader_.find(slot);
    if (reads_[static_cast<size_t>(slot)] != 1 || found == reader_.end()) return std::nullopt;
    return taken_[found->second] ? std::nullopt : std::optional(found->second);
  }

  void match(size_t i) {
    const Step& step = graph_.steps[i];
    if (!step.op || step.outputs.size() != 1 || step.outputs[0].slots.size() != 1) return;
    Candidate made;
    size_t last = i;
    if (auto convolution = as_convolution(step)) {
      take_padding(*convolution);
      made.output = convolution->output;
      made.reads = {convolution->input};
      taken_[i] = true;
      last = follow_sum(*convolution, made, last);
      last = follow_clamp(convolution->clamp, made, last);
      convolution->output = made.output;
      made.convolution = std::move(convolution);
    } else if (auto affine = as_affine(step)) {
      made.output = affine->output;
      made.reads = {affine->input};
      taken_[i] = true;
      last = follow_clamp(affine->clamp, made, last);
      affine->output = made.output;
      made.affine = std::move(affine);
    } else if (auto sum = as_sum(step)) {
      made.output = sum->output;
      made.reads = {sum->a, sum->b};
      taken_[i] = true;
      last = follow_clamp(sum->clamp, made, last);
      sum->output = made.output;
      made.sum = std::move(sum);
    } else {
      return;
    }
    taken_[i] = taken_[last] = true;
    ends_[last] = std::move(made);
  }

  std::optional<ConvolutionSpec> as_convolution(const Step& step) const {
    if (step.target != "aten::conv2d" || !step.op->schema().overload_name().empty()) return {};
    ConvolutionSpec spec;
    spec.name = step.name;
    spec.weight = weight_of(graph_, argument(step, "weight"));
    spec.bias = weight_of(graph_, argument(step, "bias"));
    spec.stride = two(argument(step, "stride"));
    spec.padding = two(argument(step, "padding"));
    spec.dilation = two(argument(step, "dilation"));
    const Input &input = argument(step, "input"), &groups = argument(step, "groups");
    spec.output = step.outputs[0].slots[0];
    const bool known = spec.weight.defined() && spec.weight.dim() == 4 &&
                       (spec.bias.defined() || is_none(argument(step, "bias"))) &&
                       groups.kind == Input::Kind::kConstant && groups.constant.isInt();
    if (!known || spec.stride.empty() || spec.padding.empty() || spec.dilation.empty() ||
        input.kind != Input::Kind::kSlot || !is_picture(input.slot) || !is_picture(spec.output)) {
      return {};
    }
    for (const at::Tensor& tensor : {spec.weight, spec.bias}) {
      if (tensor.defined() && tensor.scalar_type() != at::kFloat) return {};
    }
    spec.groups = groups.constant.toInt();
    if (precision_ == Precision::kBfloat16) spec.gradient_type = at::kBFloat16;
    spec.input = input.slot;
    spec.input_has_gradient = has_gradient(input.slot);
    return spec;
  }

  static Sizes two(const Input& input) {
    Sizes values = integers(input);
    if (values.size() == 1) values.push_back(values[0]);
    return values.size() == 2 ? values : Sizes{};
  }

  /// addcmul(shift, x, scale), what simplify_batch_norms makes, or an activation of its own.
  std::optional<AffineSpec> as_affine(const Step& step) const {
    AffineSpec spec;
    spec.output = step.outputs[0].slots[0];
    if (!is_picture(spec.output)) return {};
    if (step.target == "aten::addcmul") {
      spec.shift = weight_of(graph_, step.inputs[0]);
      spec.scale = weight_of(graph_, step.inputs[2]);
      const Input& value = step.inputs[3];
      const bool plain = step.inputs[1].kind == Input::Kind::kSlot && spec.shift.defined() &&
                         spec.scale.defined() && value.kind == Input::Kind::kConstant &&
                         value.constant.isInt() && value.constant.toInt() == 1;
      if (!plain || !same_shape(step.inputs[1].slot, spec.output)) return {};
      spec.input = step.inputs[1].slot;
      return has_gradient(spec.input) ? std::optional(spec) : std::nullopt;
    }
    const auto clamp = as_clamp(step);
    if (!clamp || !is_picture(step.inputs[0].slot) || !has_gradient(step.inputs[0].slot)) return {};
    spec.input = step.inputs[0].slot;
    spec.clamp = *clamp;
    return spec;
  }

  /// A sum of two values of the same shape.
  std::optional<SumSpec> as_sum(const Step& step) const {
    if (step.target != "aten::add" || step.op->schema().overload_name() != "Tensor") return {};
    const Input& alpha = argument(step, "alpha");
    if (alpha.kind != Input::Kind::kConstant || !alpha.constant.isScalar() ||
        alpha.constant.toScalar().toDouble() != 1) {
      return {};
    }
    SumSpec spec;
    for (const Input& input : {step.inputs[0], step.inputs[1]}) {
      if (input.kind != Input::Kind::kSlot) return {};
    }
    spec.a = step.inputs[0].slot;
    spec.b = step.inputs[1].slot;
    spec.output = step.outputs[0].slots[0];
    if (!same_shape(spec.a, spec.b)) return {};
    spec.a_has_gradient = has_gradient(spec.a);
    spec.b_has_gradient = has_gradient(spec.b);
    return spec;
  }

  /// relu, or a clamp from 0.
  static std::optional<Clamp> as_clamp(const Step& step) {
    if (step.inputs.empty() || step.inputs[0].kind != Input::Kind::kSlot) return {};
    constexpr double kInfinity = std::numeric_limits<double>::infinity();
    if (step.target == "aten::relu") return Clamp{true, kInfinity};
    if (step.target == "aten::relu6") return Clamp{true, 6};
    if (step.target != "aten::hardtanh" && step.target != "aten::clamp") return {};
    if (!step.op->schema().overload_name().empty() || step.inputs.size() < 3) return {};
    const auto number = [&](size_t i) -> std::optional<double> {
      const Input& input = step.inputs[i];
      if (input.kind != Input::Kind::kConstant || !input.constant.isScalar()) return {};
      return input.constant.toScalar().toDouble();
    };
    const auto low = number(1);
    const auto high = step.inputs[2].constant.isNone() ? kInfinity : number(2);
    if (!low || *low != 0 || !high || !(*high > 0)) return {};
    return Clamp{true, *high};
  }

  /// Takes the zero padding before the convolution, if nothing else reads its result.
  void take_padding(ConvolutionSpec& convolution) {
    const auto found = giver_.find(convolution.input);
    if (found == giver_.end() || taken_[found->second]) return;
    const Step& pad = graph_.steps[found->second];
    if (!is_zero_padding(pad) || reads_[static_cast<size_t>(convolution.input)] != 1) return;
    const Sizes around = integers(argument(pad, "pad"));
    const Slot input = argument(pad, "self").slot;
    const bool grows = std::all_of(around.begin(), around.end(), [](int64_t n) { return n >= 0; });
    if (around.size() != 4 || !grows || !is_picture(input)) return;
    convolution.around = around;
    convolution.input = input;
    taken_[found->second] = true;
  }

  /// Takes the sum that alone reads the convolution. The other term may come from anywhere before.
  size_t follow_sum(ConvolutionSpec& convolution, Candidate& made, size_t last) {
    const auto next = only_reader(made.output);
    if (!next || !graph_.steps[*next].op) return last;
    const auto sum = as_sum(graph_.steps[*next]);
    if (!sum || sum->a == sum->b) return last;
    convolution.sum = sum->a == made.output ? sum->b : sum->a;
    convolution.sum_has_gradient = has_gradient(convolution.sum);
    made.reads.push_back(convolution.sum);
    made.output = sum->output;
    taken_[*next] = true;
    return *next;
  }

  size_t follow_clamp(Clamp& clamp, Candidate& made, size_t last) {
    const auto next = only_reader(made.output);
    if (clamp.active || !next || !graph_.steps[*next].op) return last;
    const auto found = as_clamp(graph_.steps[*next]);
    if (!found) return last;
    clamp = *found;
    made.output = graph_.steps[*next].outputs[0].slots[0];
    taken_[*next] = true;
    return *next;
  }

  /// A mask is applied by the one reader of the value if that reader can do it on its way.
  void join_masks() {
    std::unordered_map<Slot, size_t> giver;
    for (size_t i = 0; i < ends_.size(); ++i) {
      if (ends_[i]) giver[ends_[i]->output] = i;
    }
    for (auto& end : ends_) {
      if (!end || !end->convolution || !applies_input_mask(*end->convolution)) continue;
      const auto found = giver.find(end->convolution->input);
      if (found == giver.end()) continue;
      auto& before = ends_[found->second]->convolution;
      if (!before || !before->clamp.active || reads_[static_cast<size_t>(before->output)] != 1) {
        continue;
      }
      before->masked_by_reader = true;
      end->convolution->input_mask = static_cast<int>(found->second);  // a step until in_order()
    }
  }

  std::vector<std::unique_ptr<PlanNode>> in_order() {
    std::vector<std::unique_ptr<PlanNode>> nodes;
    std::unordered_map<size_t, int> place;
    std::vector<Step> waiting;
    const auto flush = [&] {
      if (!waiting.empty()) nodes.push_back(dispatched(std::move(waiting)));
      waiting.clear();
    };
    for (size_t i = 0; i < graph_.steps.size(); ++i) {
      if (!ends_[i]) {
        if (!taken_[i]) waiting.push_back(graph_.steps[i]);
        continue;
      }
      flush();
      place[i] = static_cast<int>(nodes.size());
      Candidate& end = *ends_[i];
      if (end.convolution) {
        int& mask = end.convolution->input_mask;
        if (mask >= 0) mask = place.at(static_cast<size_t>(mask));
        nodes.push_back(convolution_node(std::move(*end.convolution)));
      } else {
        nodes.push_back(end.affine ? affine_node(std::move(*end.affine))
                                   : sum_node(std::move(*end.sum)));
      }
      nodes.back()->reads = end.reads;
      nodes.back()->gives = {end.output};
    }
    flush();
    return nodes;
  }

  /// The node of consecutive steps without a compiled form.
  std::unique_ptr<PlanNode> dispatched(std::vector<Step> steps) const {
    std::unordered_set<Slot> inside, seen;
    std::unordered_map<Slot, int> reads_inside;
    std::vector<Slot> reads, gives;
    for (Step& step : steps) {
      step.release.clear();
      for_each_read(step, [&](Slot slot) {
        ++reads_inside[slot];
        const bool outside = inside.count(slot) == 0 && graph_.constants.count(slot) == 0;
        if (outside && seen.insert(slot).second) reads.push_back(slot);
      });
      for (const Output& output : step.outputs) {
        inside.insert(output.slots.begin(), output.slots.end());
      }
    }
    for (const Step& step : steps) {
      for (const Output& output : step.outputs) {
        for (const Slot slot : output.slots) {
          const auto found = reads_inside.find(slot);
          const int within = found == reads_inside.end() ? 0 : found->second;
          if (reads_[static_cast<size_t>(slot)] > within) gives.push_back(slot);
        }
      }
    }
    release_inside(steps, {gives.begin(), gives.end()}, inside);
    return dispatched_node(std::move(steps), std::move(reads), std::move(gives));
  }

  /// Drops values that only these steps read after the last of them.
  static void release_inside(std::vector<Step>& steps, const std::unordered_set<Slot>& gives,
                             const std::unordered_set<Slot>& inside) {
    std::unordered_map<Slot, size_t> last;
    for (size_t i = 0; i < steps.size(); ++i) {
      for (const Output& output : steps[i].outputs) {
        for (const Slot slot : output.slots) last[slot] = i;
      }
      for_each_read(steps[i], [&](Slot slot) { last[slot] = i; });
    }
    for (const auto& [slot, step] : last) {
      if (inside.count(slot) != 0 && gives.count(slot) == 0) steps[step].release.push_back(slot);
    }
  }

  void find_releases(const std::vector<std::unique_ptr<PlanNode>>& nodes) const {
    std::unordered_map<Slot, size_t> last;
    for (size_t i = 0; i < nodes.size(); ++i) {
      for (const Slot slot : nodes[i]->gives) last[slot] = i;
      for (const Slot slot : nodes[i]->reads) last[slot] = i;
    }
    for (const auto& [slot, node] : last) {
      if (slot != graph_.output) nodes[node]->release.push_back(slot);
    }
  }

  Graph graph_;
  Precision precision_;
  std::unordered_map<Slot, Sizes> shapes_;
  std::vector<int> reads_;
  std::unordered_map<Slot, size_t> reader_, giver_;  ///< steps
  std::unordered_set<Slot> depends_;
  std::vector<std::optional<Candidate>> ends_;  ///< by last step
  std::vector<bool> taken_;                     ///< steps that belong to a candidate
};

}  // namespace

std::shared_ptr<const Plan> compile_plan(const Graph& graph, Precision precision, int64_t memory) {
  Graph functional = graph;
  const bool possible = at::hasMKLDNN() && precision != Precision::kTf32 && pays_off(graph) &&
                        can_use_channels_last(graph) && make_functional(functional);
  return possible ? Compiler(functional, precision, memory).plan() : nullptr;
}

}  // namespace tt3d::model
