#pragma once

#include <ATen/core/dispatch/Dispatcher.h>
#include <ATen/core/ivalue.h>

#include <map>
#include <optional>
#include <string>
#include <vector>

namespace tt3d::model {

/// Index of a value (tensor, symbolic number) of a graph.
using Slot = int32_t;

/// Type of a slot's value in the operator's schema.
enum class ValueType { kTensor, kInt, kFloat, kBool, kScalar };

/// One argument of a step.
struct Input {
  enum class Kind {
    kConstant,  ///< `constant`
    kNumber,    ///< `constant`, a number in place of a tensor
    kSlot,      ///< the value of `slot`, converted to `type`
    kList,      ///< `items`, as a list of `type`
    kDevice,    ///< the model's device
  };
  Kind kind = Kind::kConstant;
  c10::IValue constant;
  Slot slot = -1;
  ValueType type = ValueType::kTensor;
  bool optional_items = false;  ///< kList: Tensor?[] instead of Tensor[]
  std::vector<Input> items;
};

/// One result of a step: a value, or a list of tensors with one value each.
struct Output {
  std::vector<Slot> slots;
  bool is_list = false;
};

/// Arithmetic on sizes (symbolic.cpp).
using SymbolicFunction = c10::IValue (*)(const std::vector<c10::IValue>& arguments);

/// One operator call.
struct Step {
  std::string name;    ///< node name, for messages
  std::string target;  ///< e.g. "aten::conv2d"
  std::optional<c10::OperatorHandle> op;
  SymbolicFunction symbolic = nullptr;  ///< instead of `op`
  std::vector<Input> inputs;            ///< one per argument of the schema
  std::vector<Output> outputs;
  std::vector<Slot> release;  ///< values that no later step uses
};

/// A classifier's graph: a list of steps in order of execution.
struct Graph {
  std::vector<std::string> names;        ///< by slot
  std::map<Slot, int64_t> ranks;         ///< number of dimensions, if the file states it
  std::map<Slot, at::Tensor> constants;  ///< parameters, buffers, tensor constants
  std::vector<Step> steps;
  Slot input = -1;   ///< float32 [N,3,H,W], normalised
  Slot output = -1;  ///< float32 [N,classes] or [N,anchors,classes]
  int64_t height = 0, width = 0, classes = 0;
  bool detector = false;  ///< the output has anchors
  int64_t anchors = 0;    ///< of a detector; 0 if the file does not state their number
  int64_t min_batch = 1, max_batch = 0;  ///< batch sizes the graph was exported for
};

/// Calls `visit(slot)` for every slot that a step reads.
template <typename Visit>
void for_each_read(const Input& input, const Visit& visit) {
  if (input.kind == Input::Kind::kSlot) visit(input.slot);
  for (const Input& item : input.items) for_each_read(item, visit);
}
template <typename Visit>
void for_each_read(const Step& step, const Visit& visit) {
  for (const Input& input : step.inputs) for_each_read(input, visit);
}

}  // namespace tt3d::model
