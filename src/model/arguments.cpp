#include "arguments.h"

#include <fmt/format.h>

#include <limits>

#include "json_numbers.h"
#include "malformed.h"
#include "tensor_reader.h"

namespace tt3d::model {
namespace {

using Json = nlohmann::json;
using c10::IValue;
using Kind = c10::TypeKind;

Input constant(IValue value) {
  Input input;
  input.constant = std::move(value);
  return input;
}

Input from_slot(Slot slot, ValueType type) {
  Input input;
  input.kind = Input::Kind::kSlot;
  input.slot = slot;
  input.type = type;
  return input;
}

/// Tag and value of a tagged union, which must have exactly one member.
std::pair<std::string, const Json*> open_union(const Json& argument) {
  if (!argument.is_object() || argument.size() != 1) {
    throw Malformed("an argument is not a value with exactly one tag");
  }
  const auto member = argument.begin();
  return {member.key(), &member.value()};
}

/// JSON has no infinities, so torch writes them as strings.
double read_real(const Json& value) {
  if (!value.is_string()) return value.get<double>();
  const auto text = value.get<std::string>();
  if (text == "Infinity") return std::numeric_limits<double>::infinity();
  if (text == "-Infinity") return -std::numeric_limits<double>::infinity();
  if (text == "NaN") return std::numeric_limits<double>::quiet_NaN();
  throw Malformed(fmt::format("'{}' is not a number", text));
}

int64_t memory_format(int64_t code) {
  switch (code) {
    case 1:
      return static_cast<int64_t>(at::MemoryFormat::Contiguous);
    case 2:
      return static_cast<int64_t>(at::MemoryFormat::ChannelsLast);
    case 3:
      return static_cast<int64_t>(at::MemoryFormat::ChannelsLast3d);
    case 4:
      return static_cast<int64_t>(at::MemoryFormat::Preserve);
    default:
      throw Malformed(fmt::format("memory format {} is not supported", code));
  }
}

int64_t strided_layout(int64_t code) {
  if (code != 7) throw Malformed("only strided tensors are supported");
  return static_cast<int64_t>(at::Layout::Strided);
}

[[noreturn]] void throw_mismatch(const std::string& tag, const c10::TypePtr& type) {
  throw Malformed(fmt::format("a value '{}' where {} is expected", tag, type->str()));
}

ValueType value_type(const c10::TypePtr& type) {
  switch (type->kind()) {
    case Kind::TensorType:
      return ValueType::kTensor;
    case Kind::FloatType:
    case Kind::SymFloatType:
      return ValueType::kFloat;
    case Kind::BoolType:
    case Kind::SymBoolType:
      return ValueType::kBool;
    case Kind::NumberType:
      return ValueType::kScalar;
    case Kind::IntType:
    case Kind::SymIntType:
      return ValueType::kInt;
    default:
      throw Malformed(fmt::format("a symbol where {} is expected", type->str()));
  }
}

/// A number without symbols, with its own type.
std::optional<IValue> literal_number(const std::string& tag, const Json& value) {
  if (tag == "as_int") return IValue(read_integer(value));
  if (tag == "as_float") return IValue(read_real(value));
  if (tag == "as_bool") return IValue(value.get<bool>());
  if (tag == "as_scalar_type") {
    return IValue(static_cast<int64_t>(scalar_type_of(read_integer(value))));
  }
  if (tag == "as_memory_format") return IValue(memory_format(read_integer(value)));
  if (tag == "as_layout") return IValue(strided_layout(read_integer(value)));
  return std::nullopt;
}

bool is_symbol_tag(const std::string& tag) {
  return tag == "as_sym_int" || tag == "as_sym_float" || tag == "as_sym_bool";
}

/// Converts a literal to the schema's type, if that loses nothing.
Input fit_literal(const IValue& number, const std::string& tag, const c10::TypePtr& type) {
  switch (value_type(type)) {
    case ValueType::kTensor: {
      Input input = constant(number);
      input.kind = Input::Kind::kNumber;
      return input;
    }
    case ValueType::kScalar:
      return constant(number);
    case ValueType::kFloat:
      if (number.isBool()) throw_mismatch(tag, type);
      return constant(number.isInt() ? static_cast<double>(number.toInt()) : number.toDouble());
    case ValueType::kBool:
      if (!number.isBool()) throw_mismatch(tag, type);
      return constant(number);
    case ValueType::kInt:
      if (number.isDouble()) throw_mismatch(tag, type);
      return constant(number.isBool() ? static_cast<int64_t>(number.toBool()) : number.toInt());
  }
  throw_mismatch(tag, type);
}

/// One scalar, symbol, tensor, string or device.
Input read_single(const std::string& tag, const Json& value, const c10::TypePtr& type,
                  const SlotOf& slot_of) {
  if (type->kind() == Kind::StringType) {
    if (tag != "as_string") throw_mismatch(tag, type);
    return constant(value.get<std::string>());
  }
  if (type->kind() == Kind::DeviceObjType) {
    if (tag != "as_device") throw_mismatch(tag, type);
    Input input;
    input.kind = Input::Kind::kDevice;
    return input;
  }
  if (tag == "as_tensor") {
    if (type->kind() != Kind::TensorType) throw_mismatch(tag, type);
    return from_slot(slot_of(value.at("name").get<std::string>()), ValueType::kTensor);
  }
  if (is_symbol_tag(tag)) {
    const auto [inner_tag, inner] = open_union(value);
    if (inner_tag == "as_name")
      return from_slot(slot_of(inner->get<std::string>()), value_type(type));
    return read_single(inner_tag, *inner, type, slot_of);
  }
  const auto number = literal_number(tag, value);
  if (!number) throw_mismatch(tag, type);
  return fit_literal(*number, tag, type);
}

/// A constant list of numbers, if none of the items is a symbol.
std::optional<IValue> constant_list(const std::vector<Input>& items, ValueType type) {
  for (const Input& item : items) {
    if (item.kind != Input::Kind::kConstant || item.constant.isNone()) return std::nullopt;
  }
  if (type == ValueType::kInt) {
    c10::List<int64_t> list;
    for (const Input& item : items) list.push_back(item.constant.toInt());
    return IValue(list);
  }
  if (type == ValueType::kFloat) {
    c10::List<double> list;
    for (const Input& item : items) list.push_back(item.constant.toDouble());
    return IValue(list);
  }
  if (type == ValueType::kBool) {
    c10::List<bool> list;
    for (const Input& item : items) list.push_back(item.constant.toBool());
    return IValue(list);
  }
  return std::nullopt;
}

Input make_list(std::vector<Input> items, const c10::TypePtr& element, bool optional_items) {
  const ValueType type = value_type(element);
  if (auto list = constant_list(items, type); list && !optional_items) return constant(*list);
  Input input;
  input.kind = Input::Kind::kList;
  input.type = type;
  input.optional_items = optional_items;
  input.items = std::move(items);
  return input;
}

/// Tag of the items in a list with this tag; "" if each item has its own tag.
std::string item_tag(const std::string& list_tag) {
  if (list_tag == "as_tensors") return "as_tensor";
  if (list_tag == "as_ints") return "as_int";
  if (list_tag == "as_floats") return "as_float";
  if (list_tag == "as_bools") return "as_bool";
  return "";
}

Input read_item(const std::string& tag, const Json& item, const c10::TypePtr& element,
                bool optional_items, const SlotOf& slot_of) {
  if (!tag.empty()) return read_single(tag, item, element, slot_of);
  const auto [own_tag, value] = open_union(item);
  if (own_tag == "as_none" && optional_items) return constant(IValue());
  if (own_tag == "as_name")
    return from_slot(slot_of(value->get<std::string>()), value_type(element));
  return read_single(own_tag, *value, element, slot_of);
}

Input read_list(const std::string& tag, const Json& value, const c10::TypePtr& list_type,
                std::optional<int32_t> fixed_size, const SlotOf& slot_of) {
  c10::TypePtr element = list_type->castRaw<c10::ListType>()->getElementType();
  const bool optional_items = element->kind() == Kind::OptionalType;
  if (optional_items) element = element->castRaw<c10::OptionalType>()->getElementType();
  std::vector<Input> items;
  if (!value.is_array()) {
    if (!fixed_size) throw_mismatch(tag, list_type);
    items.assign(static_cast<size_t>(*fixed_size), read_single(tag, value, element, slot_of));
    return make_list(std::move(items), element, optional_items);
  }
  for (const Json& item : value) {
    items.push_back(read_item(item_tag(tag), item, element, optional_items, slot_of));
  }
  return make_list(std::move(items), element, optional_items);
}

}  // namespace

Input read_argument(const Json& argument, const c10::TypePtr& type,
                    std::optional<int32_t> fixed_size, const SlotOf& slot_of) {
  const auto [tag, value] = open_union(argument);
  if (tag == "as_optional_tensor") return read_argument(*value, type, fixed_size, slot_of);
  if (type->kind() == Kind::OptionalType) {
    if (tag == "as_none") return constant(IValue());
    const auto& inner = type->castRaw<c10::OptionalType>()->getElementType();
    return read_argument(argument, inner, fixed_size, slot_of);
  }
  if (type->kind() == Kind::ListType) return read_list(tag, *value, type, fixed_size, slot_of);
  return read_single(tag, *value, type, slot_of);
}

Input read_number(const Json& argument, const SlotOf& slot_of) {
  const auto [tag, value] = open_union(argument);
  return read_single(tag, *value, c10::NumberType::get(), slot_of);
}

}  // namespace tt3d::model
