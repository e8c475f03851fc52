#include "program.h"

#include <fmt/format.h>

#include "malformed.h"

namespace tt3d::model {
namespace {

using c10::IValue;

/// Memory that the values of a run hold. With autograd on, what backward needs stays after the
/// value itself is released, so nothing is given back.
class MemoryMeter {
 public:
  MemoryMeter(int64_t limit, bool keeps_all) : limit_(limit), keeps_all_(keeps_all) {}

  void add(const at::Tensor& tensor) {
    held_ += static_cast<int64_t>(tensor.storage().nbytes());
    if (held_ <= limit_) return;
    throw MemoryLimit(fmt::format("intermediate results pass the limit of {} bytes", limit_));
  }
  void release(const at::Tensor& tensor) {
    if (keeps_all_ || tensor.storage().use_count() != 1) return;
    held_ -= static_cast<int64_t>(tensor.storage().nbytes());
  }

 private:
  int64_t limit_;
  bool keeps_all_;
  int64_t held_ = 0;
};

at::Tensor to_tensor(const IValue& value) {
  if (value.isTensor()) return value.toTensor();
  if (!value.isScalar()) throw Malformed("expected a tensor or number");
  at::Tensor tensor = at::scalar_tensor(
      value.toScalar(), at::TensorOptions().dtype(value.isDouble() ? at::kDouble : at::kLong));
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

/// The state of one run.
class Run {
 public:
  Run(const Graph& graph, const at::Tensor& images, int64_t intermediate_bytes)
      : graph_(graph),
        device_(images.device()),
        values_(graph.names.size()),
        meter_(intermediate_bytes, at::GradMode::is_enabled() && images.requires_grad()) {
    for (const auto& [slot, tensor] : graph.constants) values_[static_cast<size_t>(slot)] = tensor;
    values_[static_cast<size_t>(graph.input)] = images;
  }

  at::Tensor all() {
    for (const Step& step : graph_.steps) run(step);
    const IValue& logits = values_[static_cast<size_t>(graph_.output)];
    if (!logits.isTensor()) throw Malformed("the output is not a tensor");
    return logits.toTensor();
  }

 private:
  IValue& value(Slot slot) { return values_[static_cast<size_t>(slot)]; }

  void run(const Step& step) {
    try {
      step.op ? call(step) : compute(step);
    } catch (const c10::Error& error) {
      throw Malformed(fmt::format("node '{}' ({}) fails: {}", step.name, step.target,
                                  first_line(error.what_without_backtrace())));
    } catch (const Malformed& error) {
      throw Malformed(fmt::format("node '{}' ({}): {}", step.name, step.target, error.what()));
    }
    for (const Slot slot : step.release) {
      if (value(slot).isTensor()) meter_.release(value(slot).toTensor());
      value(slot) = IValue();
    }
  }

  static std::string first_line(const std::string& text) { return text.substr(0, text.find('\n')); }

  void compute(const Step& step) {
    std::vector<IValue> arguments;
    for (const Input& input : step.inputs) arguments.push_back(make(input));
    value(step.outputs[0].slots[0]) = step.symbolic(arguments);
  }

  void call(const Step& step) {
    torch::jit::Stack stack;
    stack.reserve(step.inputs.size());
    for (const Input& input : step.inputs) stack.push_back(make(input));
    step.op->callBoxed(stack);
    for (size_t i = 0; i < step.outputs.size(); ++i) store(step, step.outputs[i], stack.at(i));
  }

  IValue make(const Input& input) {
    switch (input.kind) {
      case Input::Kind::kConstant:
        return input.constant;
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
    bool shared = false;
    for_each_read(step, [&](Slot slot) {
      const IValue& other = value(slot);
      shared |= other.isTensor() && other.toTensor().is_alias_of(tensor);
    });
    if (!shared) meter_.add(tensor);
  }

  const Graph& graph_;
  at::Device device_;
  std::vector<IValue> values_;
  MemoryMeter meter_;
};

}  // namespace

at::Tensor run_graph(const Graph& graph, const at::Tensor& images, int64_t intermediate_bytes) {
  return Run(graph, images, intermediate_bytes).all();
}

}  // namespace tt3d::model
