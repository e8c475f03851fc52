#include "program.h"

#include <fmt/format.h>

#include <unordered_set>

#include "argument_checks.h"
#include "malformed.h"

namespace tt3d::model {
namespace {

using c10::IValue;

/// A number in place of a tensor takes the other operand's type, as in Python. It is a new tensor
/// each time, since an operator may write into it.
at::Tensor to_tensor(const IValue& value) {
  if (value.isTensor()) return value.toTensor();
  if (!value.isScalar()) throw Malformed("expected a tensor or number");
  const auto type = value.isDouble() ? at::kDouble : value.isBool() ? at::kBool : at::kLong;
  at::Tensor tensor = at::scalar_tensor(value.toScalar(), at::TensorOptions().dtype(type));
  tensor.unsafeGetTensorImpl()->set_wrapped_number(true);
  return tensor;
}

IValue as_type(const IValue& value, ValueType type) {
  const bool number = value.isInt() || value.isDouble() || value.isBool();
  switch (type) {
    case ValueType::kTensor:
      return to_tensor(value);
    case ValueType::kInt:
      if (value.isInt()) return value;
      if (value.isBool()) return static_cast<int64_t>(value.toBool());
      break;
    case ValueType::kFloat:
      if (value.isInt()) return static_cast<double>(value.toInt());
      if (value.isDouble()) return value;
      break;
    case ValueType::kBool:
      if (value.isBool()) return value;
      break;
    case ValueType::kScalar:
      if (number) return value;
      break;
  }
  throw Malformed("a value has the wrong type");
}

bool is_convolution(const Step& step) { return step.target.starts_with("aten::conv"); }
bool is_layer(const Step& step) { return is_convolution(step) || step.target == "aten::linear"; }

}  // namespace

void throw_node_error(const std::string& name, const std::string& target, const c10::Error& error) {
  if (is_out_of_memory(error)) throw MemoryLimit("out of memory");
  const std::string text = error.what_without_backtrace();
  throw Malformed(
      fmt::format("node '{}' ({}) fails: {}", name, target, text.substr(0, text.find('\n'))));
}

class StepRunner::Run {
 public:
  Run(const Graph& graph, at::Device device, std::vector<IValue>& values, MemoryMeter& meter,
      LayerTap* tap)
      : device_(device), values_(values), meter_(meter), tap_(tap) {
    values_.resize(graph.names.size());
    for (const auto& [slot, tensor] : graph.constants) {
      values_[static_cast<size_t>(slot)] = tensor;
      weight_memory_.insert(tensor.storage().unsafeGetStorageImpl());
    }
    for (const Step& step : graph.steps) {
      if (is_layer(step)) last_layer_ = &step;
    }
  }

  void run(const Step& step) {
    try {
      step.op ? call(step) : compute(step);
    } catch (const c10::Error& error) {
      throw_node_error(step.name, step.target, error);
    } catch (const Malformed& error) {
      throw Malformed(fmt::format("node '{}' ({}): {}", step.name, step.target, error.what()));
    }
    for (const Slot slot : step.release) {
      if (value(slot).isTensor()) meter_.release(value(slot).toTensor());
      value(slot) = IValue();
    }
  }

 private:
  IValue& value(Slot slot) { return values_[static_cast<size_t>(slot)]; }

  void compute(const Step& step) {
    std::vector<IValue> arguments;
    for (const Input& input : step.inputs) arguments.push_back(make(input));
    value(step.outputs[0].slots[0]) = step.symbolic(arguments);
  }

  void call(const Step& step) {
    torch::jit::Stack stack;
    stack.reserve(step.inputs.size());
    for (const Input& input : step.inputs) stack.push_back(make(input));
    check_writes(step, stack);
    check_arguments(step, stack);
    step.op->callBoxed(stack);
    if (tap_ != nullptr) tell_tap(step, stack);
    for (size_t i = 0; i < step.outputs.size(); ++i) store(step, step.outputs[i], stack.at(i));
  }

  /// The last layer is skipped: it gives the logits, whatever follows it.
  void tell_tap(const Step& step, torch::jit::Stack& stack) {
    if (!is_layer(step) || &step == last_layer_) return;
    stack[0] = tap_->take(layer_++, stack[0].toTensor(), is_convolution(step));
  }

  /// The reader has checked the graph for writes to weights. This check also finds views that no
  /// schema declares.
  void check_writes(const Step& step, const torch::jit::Stack& stack) const {
    const auto& arguments = step.op->schema().arguments();
    for (size_t i = 0; i < arguments.size(); ++i) {
      const auto* alias = arguments[i].alias_info();
      if (alias == nullptr || !alias->isWrite() || !stack[i].isTensor()) continue;
      const at::Tensor& tensor = stack[i].toTensor();
      if (tensor.defined() && weight_memory_.count(tensor.storage().unsafeGetStorageImpl()) != 0) {
        throw Malformed("writes to a weight; a victim must not change");
      }
    }
  }

  IValue make(const Input& input) {
    switch (input.kind) {
      case Input::Kind::kConstant:
        return input.constant;
      case Input::Kind::kNumber:
        return to_tensor(input.constant);
      case Input::Kind::kSlot:
        return as_type(value(input.slot), input.type);
      case Input::Kind::kDevice:
        return device_;
      case Input::Kind::kList:
        return make_list(input);
    }
    throw Malformed("unknown argument");
  }

  IValue make_list(const Input& input) {
    if (input.optional_items) {
      c10::List<std::optional<at::Tensor>> list;
      for (const Input& item : input.items) {
        const IValue made = make(item);
        list.push_back(made.isNone() ? std::nullopt : std::optional(made.toTensor()));
      }
      return list;
    }
    switch (input.type) {
      case ValueType::kTensor:
        return typed_list<at::Tensor>(input);
      case ValueType::kFloat:
        return typed_list<double>(input);
      case ValueType::kBool:
        return typed_list<bool>(input);
      default:
        return typed_list<int64_t>(input);
    }
  }

  template <typename T>
  IValue typed_list(const Input& input) {
    c10::List<T> list;
    list.reserve(input.items.size());
    for (const Input& item : input.items) list.push_back(make(item).template to<T>());
    return list;
  }

  void store(const Step& step, const Output& output, IValue& result) {
    if (output.slots.empty()) return;
    if (!output.is_list) {
      count(step, result);
      value(output.slots[0]) = std::move(result);
      return;
    }
    const auto list = result.toTensorVector();
    if (list.size() != output.slots.size()) {
      throw Malformed(
          fmt::format("gives {} tensors, the graph states {}", list.size(), output.slots.size()));
    }
    for (size_t i = 0; i < list.size(); ++i) {
      count(step, list[i]);
      value(output.slots[i]) = list[i];
    }
  }

  /// Adds a result to the meter unless it shares the memory of an argument.
  void count(const Step& step, const IValue& result) {
    if (!result.isTensor() || !result.toTensor().defined()) return;
    const at::Tensor& tensor = result.toTensor();
    meter_.check_size(tensor);
    bool shared = false;
    for_each_read(step, [&](Slot slot) {
      const IValue& other = value(slot);
      shared |= other.isTensor() && other.toTensor().is_alias_of(tensor);
    });
    if (!shared) meter_.add(tensor);
  }

  at::Device device_;
  std::vector<IValue>& values_;
  std::unordered_set<const c10::StorageImpl*> weight_memory_;
  MemoryMeter& meter_;
  LayerTap* tap_;
  const Step* last_layer_ = nullptr;
  int64_t layer_ = 0;
};

StepRunner::StepRunner(const Graph& graph, at::Device device, std::vector<IValue>& values,
                       MemoryMeter& meter, LayerTap* tap)
    : run_(std::make_unique<Run>(graph, device, values, meter, tap)) {}

StepRunner::~StepRunner() = default;

void StepRunner::run(const Step& step) { run_->run(step); }

at::Tensor run_graph(const Graph& graph, const at::Tensor& images, MemoryMeter& meter,
                     LayerTap* tap) {
  std::vector<IValue> values;
  StepRunner runner(graph, images.device(), values, meter, tap);
  values[static_cast<size_t>(graph.input)] = images;
  for (const Step& step : graph.steps) runner.run(step);
  const IValue& logits = values[static_cast<size_t>(graph.output)];
  if (!logits.isTensor()) throw Malformed("the output is not a tensor");
  return logits.toTensor();
}

}  // namespace tt3d::model
