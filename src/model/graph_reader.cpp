#include "graph_reader.h"

#include <fmt/format.h>

#include <unordered_map>

#include "arguments.h"
#include "json_numbers.h"
#include "malformed.h"
#include "operators.h"
#include "symbolic.h"
#include "tensor_reader.h"

namespace tt3d::model {
namespace {

using Json = nlohmann::json;

constexpr int64_t kMajorVersion = 8;
constexpr int64_t kFloat32 = 7;
constexpr int64_t kMaxBatch = 1 << 20;

class GraphReader {
 public:
  GraphReader(const Archive& archive, const ModelLimits& limits);
  Graph read();

 private:
  void check_version() const;
  void read_inputs();
  void bind_weight(const std::string& argument, const std::string& weight);
  void read_nodes();
  Step read_node(const Json& node);
  void read_operator(const Json& node, Step& step);
  void read_operator_inputs(const Json& node, Step& step);
  void read_symbolic(const Json& node, Step& step);
  void read_step_outputs(const Json& node, Step& step);
  Output read_output(const Json& output);
  void read_output_spec();
  void read_ranks();
  void check_input_shape();
  void check_output_shape();
  void read_batch_range(const Json& size);
  Slot define(const std::string& name);
  Slot find(const std::string& name) const;

  const ModelLimits& limits_;
  Json document_;
  const Json* module_ = nullptr;
  const Json* json_graph_ = nullptr;
  std::map<std::string, NamedTensor> tensors_;
  std::unordered_map<std::string, Slot> slots_;
  std::string input_name_, output_name_;
  Graph graph_;
};

GraphReader::GraphReader(const Archive& archive, const ModelLimits& limits) : limits_(limits) {
  const std::string model = archive.model_name();
  document_ = archive.json("models/" + model + ".json");
  check_version();
  tensors_ = read_tensors(archive, model, limits);
  module_ = &document_.at("graph_module");
  json_graph_ = &module_->at("graph");
}

void GraphReader::check_version() const {
  const auto major = read_integer(document_.at("schema_version").at("major"));
  if (major != kMajorVersion) {
    throw Malformed(
        fmt::format("has export schema version {}, expected {} (torch 2.9 to 2.11); "
                    "export it with torch 2.11",
                    major, kMajorVersion));
  }
}

Slot GraphReader::define(const std::string& name) {
  const auto slot = static_cast<Slot>(graph_.names.size());
  if (!slots_.emplace(name, slot).second) {
    throw Malformed(fmt::format("value '{}' is defined twice", name));
  }
  graph_.names.push_back(name);
  return slot;
}

Slot GraphReader::find(const std::string& name) const {
  const auto found = slots_.find(name);
  if (found == slots_.end()) {
    throw Malformed(
        fmt::format("uses '{}' before anything defines it (a cycle or a missing node)", name));
  }
  return found->second;
}

void GraphReader::bind_weight(const std::string& argument, const std::string& weight) {
  const auto found = tensors_.find(weight);
  if (found == tensors_.end()) throw Malformed(fmt::format("weight '{}' is missing", weight));
  graph_.constants.emplace(define(argument), found->second.tensor);
}

void GraphReader::read_inputs() {
  for (const Json& spec : module_->at("signature").at("input_specs")) {
    const std::string kind = spec.begin().key();
    const Json& value = spec.begin().value();
    if (kind == "parameter" || kind == "buffer" || kind == "tensor_constant") {
      bind_weight(value.at("arg").at("name").get<std::string>(),
                  value.at(kind + "_name").get<std::string>());
    } else if (kind == "user_input" && value.at("arg").contains("as_tensor")) {
      if (graph_.input >= 0) throw Malformed("takes more than one input, expected one image batch");
      input_name_ = value.at("arg").at("as_tensor").at("name").get<std::string>();
      graph_.input = define(input_name_);
    } else {
      throw Malformed(
          fmt::format("takes an input of kind '{}', expected weights and one image "
                      "batch",
                      kind));
    }
  }
  if (graph_.input < 0) throw Malformed("takes no image input");
}

void GraphReader::read_nodes() {
  const Json& nodes = json_graph_->at("nodes");
  if (static_cast<int64_t>(nodes.size()) > limits_.nodes) {
    throw Malformed(
        fmt::format("has {} nodes, more than the limit of {}; raise nodes of the model "
                    "limits if you trust it",
                    nodes.size(), limits_.nodes));
  }
  for (const Json& node : nodes) {
    std::string name = "?";
    try {
      name = node.at("outputs").empty() ? "?" : node.value("name", Json("?")).dump();
      if (is_assertion(node.at("target").get<std::string>())) continue;
      graph_.steps.push_back(read_node(node));
    } catch (const Malformed& error) {
      throw Malformed(fmt::format("node {}: {}", name, error.what()));
    } catch (const Json::exception& error) {
      throw Malformed(fmt::format("node {}: {}", name, error.what()));
    }
  }
}

Step GraphReader::read_node(const Json& node) {
  Step step;
  step.name = node.contains("name") && node["name"].is_string() ? node["name"].get<std::string>()
                                                                : "unnamed";
  const auto target = node.at("target").get<std::string>();
  step.symbolic = find_symbolic(target);
  if (step.symbolic != nullptr) {
    step.target = target;
    read_symbolic(node, step);
  } else {
    read_operator(node, step);
  }
  read_step_outputs(node, step);
  return step;
}

void GraphReader::read_symbolic(const Json& node, Step& step) {
  for (const Json& input : node.at("inputs")) {
    step.inputs.push_back(
        read_number(input.at("arg"), [this](const std::string& name) { return find(name); }));
  }
}

void GraphReader::read_operator(const Json& node, Step& step) {
  std::string target = node.at("target").get<std::string>();
  // In-place detach fails on views; the result is equal.
  if (target == "torch.ops.aten.detach_.default") target = "torch.ops.aten.detach.default";
  // Uninitialised memory must not become an input.
  if (target == "torch.ops.aten.empty_like.default") target = "torch.ops.aten.zeros_like.default";
  step.op = find_operator(target);
  step.target = step.op->schema().name();
  read_operator_inputs(node, step);
  check_evaluation_mode(step);
}

void GraphReader::read_operator_inputs(const Json& node, Step& step) {
  std::unordered_map<std::string, const Json*> given;
  for (const Json& input : node.at("inputs")) {
    if (!given.emplace(input.at("name").get<std::string>(), &input.at("arg")).second) {
      throw Malformed("has a duplicate argument");
    }
  }
  const auto slot_of = [this](const std::string& name) { return find(name); };
  size_t used = 0;
  for (const c10::Argument& argument : step.op->schema().arguments()) {
    const auto found = given.find(argument.name());
    if (found == given.end()) {
      if (!argument.default_value()) {
        throw Malformed(
            fmt::format("argument '{}' of {} is missing", argument.name(), step.target));
      }
      step.inputs.emplace_back();
      step.inputs.back().constant = *argument.default_value();
      continue;
    }
    ++used;
    try {
      step.inputs.push_back(read_argument(*found->second, argument.type(), argument.N(), slot_of));
    } catch (const Malformed& error) {
      throw Malformed(
          fmt::format("argument '{}' of {}: {}", argument.name(), step.target, error.what()));
    }
  }
  if (used != given.size()) {
    throw Malformed(fmt::format("has an argument that {} does not know", step.target));
  }
}

Output GraphReader::read_output(const Json& output) {
  Output result;
  const std::string kind = output.begin().key();
  const Json& value = output.begin().value();
  if (kind == "as_tensors") {
    result.is_list = true;
    for (const Json& item : value) {
      result.slots.push_back(define(item.at("name").get<std::string>()));
    }
  } else if (kind == "as_tensor") {
    result.slots.push_back(define(value.at("name").get<std::string>()));
  } else if (kind == "as_sym_int" || kind == "as_sym_bool" || kind == "as_sym_float") {
    result.slots.push_back(define(value.at("as_name").get<std::string>()));
  } else if (kind != "as_none") {
    throw Malformed(fmt::format("gives a result of kind '{}'", kind));
  }
  return result;
}

void GraphReader::read_step_outputs(const Json& node, Step& step) {
  for (const Json& output : node.at("outputs")) {
    if (!output.is_object() || output.size() != 1) throw Malformed("has a malformed result");
    step.outputs.push_back(read_output(output));
  }
  const size_t expected = step.op ? step.op->schema().returns().size() : 1;
  if (step.outputs.size() != expected) {
    throw Malformed(
        fmt::format("states {} results, {} gives {}", step.outputs.size(), step.target, expected));
  }
}

void GraphReader::read_output_spec() {
  const Json& specs = module_->at("signature").at("output_specs");
  const bool one = specs.is_array() && specs.size() == 1 && specs[0].contains("user_output") &&
                   specs[0]["user_output"].at("arg").contains("as_tensor");
  if (!one) {
    throw Malformed(
        "does not give exactly one tensor; a classifier gives logits [N,classes] and "
        "writes to no buffer (export it after model.eval())");
  }
  output_name_ = specs[0]["user_output"]["arg"]["as_tensor"].at("name").get<std::string>();
  graph_.output = find(output_name_);
}

void GraphReader::read_batch_range(const Json& size) {
  if (size.contains("as_int")) {
    graph_.min_batch = graph_.max_batch = read_integer(size["as_int"]);
  } else {
    graph_.max_batch = kMaxBatch;
    const auto text = size.at("as_expr").at("expr_str").get<std::string>();
    const size_t open = text.find('\''), close = text.find('\'', open + 1);
    if (!text.starts_with("Symbol(") || close == std::string::npos) {
      throw Malformed(fmt::format("has a batch size '{}', expected a plain symbol", text));
    }
    const std::string symbol = text.substr(open + 1, close - open - 1);
    const Json ranges = document_.value("range_constraints", Json::object());
    if (ranges.contains(symbol)) {
      const Json& range = ranges[symbol];
      if (range.value("min_val", Json()).is_number_integer()) graph_.min_batch = range["min_val"];
      if (range.value("max_val", Json()).is_number_integer()) graph_.max_batch = range["max_val"];
    }
  }
  graph_.min_batch = std::max<int64_t>(graph_.min_batch, 1);
  graph_.max_batch = std::min(graph_.max_batch, kMaxBatch);
  if (graph_.max_batch < graph_.min_batch) throw Malformed("allows no batch size");
}

void GraphReader::read_ranks() {
  for (const auto& [name, meta] : json_graph_->at("tensor_values").items()) {
    const auto slot = slots_.find(name);
    if (slot == slots_.end()) continue;
    graph_.ranks[slot->second] = static_cast<int64_t>(meta.at("sizes").size());
  }
}

void GraphReader::check_input_shape() {
  const Json& meta = json_graph_->at("tensor_values").at(input_name_);
  const Json& sizes = meta.at("sizes");
  if (meta.at("dtype") != kFloat32 || sizes.size() != 4 || sizes[1].value("as_int", 0) != 3 ||
      !sizes[2].contains("as_int") || !sizes[3].contains("as_int")) {
    throw Malformed("does not take float32 images [N,3,H,W] of fixed size H x W");
  }
  graph_.height = read_integer(sizes[2]["as_int"]);
  graph_.width = read_integer(sizes[3]["as_int"]);
  read_batch_range(sizes[0]);
}

void GraphReader::check_output_shape() {
  const Json& meta = json_graph_->at("tensor_values").at(output_name_);
  const Json& sizes = meta.at("sizes");
  const bool fits = meta.at("dtype") == kFloat32 && (sizes.size() == 2 || sizes.size() == 3) &&
                    sizes.back().contains("as_int");
  if (!fits) {
    throw Malformed(
        "does not give float32 logits [N,classes], nor a detector's scores [N,anchors,classes]");
  }
  graph_.classes = read_integer(sizes.back()["as_int"]);
  graph_.detector = sizes.size() == 3;
  if (graph_.detector && sizes[1].contains("as_int")) {
    graph_.anchors = read_integer(sizes[1]["as_int"]);
  }
  if (graph_.classes < 2) throw Malformed("has fewer than two classes");
}

Graph GraphReader::read() {
  read_inputs();
  read_nodes();
  read_output_spec();
  read_ranks();
  check_input_shape();
  check_output_shape();
  check_weights_are_read_only(graph_);
  return std::move(graph_);
}

}  // namespace

Graph read_graph(const Archive& archive, const ModelLimits& limits) {
  try {
    return GraphReader(archive, limits).read();
  } catch (const Json::exception& error) {
    throw Malformed(fmt::format("the graph is malformed: {}", error.what()));
  }
}

}  // namespace tt3d::model
