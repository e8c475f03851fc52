#include <fmt/format.h>

#include <algorithm>
#include <unordered_map>
#include <unordered_set>

#include "graph_reader.h"
#include "malformed.h"

namespace tt3d::model {
namespace {

/// Operators whose result may share memory with an argument although their schema does not say so.
bool may_alias(const std::string& target) {
  static const std::unordered_set<std::string> names = {
      "aten::reshape",    "aten::reshape_as", "aten::contiguous",   "aten::flatten",
      "aten::to",         "aten::type_as",    "aten::expand_as",    "aten::view_as",
      "aten::lift_fresh", "aten::lift",       "aten::dropout",      "aten::feature_dropout",
      "aten::pad",        "aten::meshgrid",   "aten::alpha_dropout"};
  return names.count(target) != 0;
}

/// Operators that only move or copy values.
bool keeps_values(const std::string& target) {
  static const std::unordered_set<std::string> names = {
      "aten::view",      "aten::reshape",   "aten::flatten",    "aten::squeeze", "aten::unsqueeze",
      "aten::permute",   "aten::transpose", "aten::contiguous", "aten::clone",   "aten::alias",
      "aten::detach",    "aten::to",        "aten::_to_copy",   "aten::slice",   "aten::dropout",
      "aten::unflatten", "aten::lift_fresh"};
  return names.count(target) != 0;
}

const Step* step_that_gives(const Graph& graph, Slot slot) {
  for (const Step& step : graph.steps) {
    for (const Output& output : step.outputs) {
      if (std::find(output.slots.begin(), output.slots.end(), slot) != output.slots.end()) {
        return &step;
      }
    }
  }
  return nullptr;
}

}  // namespace

std::string probability_layer(const Graph& graph) {
  Slot slot = graph.output;
  for (const Step* step = step_that_gives(graph, slot); step != nullptr;
       step = step_that_gives(graph, slot)) {
    if (step->target.find("::softmax") != std::string::npos ||
        step->target.find("::_softmax") != std::string::npos) {
      return "softmax";
    }
    if (step->target.find("::sigmoid") != std::string::npos) return "sigmoid";
    if (!keeps_values(step->target) || step->inputs.empty()) return "";
    slot = step->inputs.front().slot;
  }
  return "";
}

void check_weights_are_read_only(const Graph& graph) {
  std::unordered_set<Slot> weights;
  for (const auto& [slot, tensor] : graph.constants) weights.insert(slot);
  for (const Step& step : graph.steps) {
    if (!step.op) continue;
    bool alias = false;
    const auto& arguments = step.op->schema().arguments();
    for (size_t i = 0; i < arguments.size(); ++i) {
      bool weight = false;
      for_each_read(step.inputs[i], [&](Slot slot) { weight |= weights.count(slot) != 0; });
      const auto* info = arguments[i].alias_info();
      if (weight && info != nullptr && info->isWrite()) {
        throw Malformed(fmt::format("node '{}' ({}) writes to a weight; a victim must not change",
                                    step.name, step.target));
      }
      alias |= weight && (info != nullptr || may_alias(step.target));
    }
    if (!alias) continue;
    for (const Output& output : step.outputs)
      weights.insert(output.slots.begin(), output.slots.end());
  }
}

void find_last_uses(Graph& graph) {
  std::unordered_map<Slot, size_t> last;
  for (size_t i = 0; i < graph.steps.size(); ++i) {
    graph.steps[i].release.clear();
    for (const Output& output : graph.steps[i].outputs) {
      for (const Slot slot : output.slots) last[slot] = i;
    }
    for_each_read(graph.steps[i], [&](Slot slot) { last[slot] = i; });
  }
  for (const auto& [slot, step] : last) {
    if (slot == graph.output || graph.constants.count(slot) != 0) continue;
    graph.steps[step].release.push_back(slot);
  }
}

}  // namespace tt3d::model
