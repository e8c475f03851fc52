#include "tt3d/json.h"

#include <algorithm>

#include "tt3d/core.h"
#include "tt3d/input_files.h"

namespace tt3d {

using nlohmann::json;

json parse_json(const std::string& text, const std::filesystem::path& path) {
  if (text.empty()) throw InputError(path, "the file is empty, expected JSON");
  try {
    return json::parse(text);
  } catch (const json::parse_error& error) {
    const size_t end = std::min(text.size(), error.byte);
    const auto line = 1 + std::count(text.begin(), text.begin() + static_cast<long>(end), '\n');
    throw InputError(path, line, "is not valid JSON (NaN and Infinity are not numbers in JSON)");
  } catch (const json::exception&) {
    throw InputError(path, "has a number that is out of range");
  }
}

json read_json(const std::filesystem::path& path) { return parse_json(read_text(path), path); }

void write_json(const std::filesystem::path& path, const json& value) {
  write_file_atomic(path, value.dump(1) + "\n");
}

std::string JsonValue::where() const { return path_.string() + (key_.empty() ? "" : ": " + key_); }

void JsonValue::fail(const std::string& problem) const {
  throw InputError(path_, key_.empty() ? problem : key_ + ": " + problem);
}

bool JsonValue::has(const std::string& key) const {
  if (!value_->is_object()) fail("expected an object");
  const auto found = value_->find(key);
  return found != value_->end() && !found->is_null();
}

JsonValue JsonValue::at(const std::string& key) const {
  if (!value_->is_object()) fail("expected an object");
  const std::string name = key_.empty() ? key : key_ + "." + key;
  const auto found = value_->find(key);
  if (found == value_->end()) throw InputError(path_, name + ": is missing");
  return {*found, path_, name};
}

JsonValue JsonValue::at(size_t index) const {
  if (index >= size()) fail("expected more than " + std::to_string(index) + " elements");
  return {(*value_)[index], path_, key_ + "[" + std::to_string(index) + "]"};
}

size_t JsonValue::size() const {
  if (!value_->is_array()) fail("expected a list");
  return value_->size();
}

void read(const JsonValue& from, bool& to) {
  if (!from.raw().is_boolean()) from.fail("expected true or false");
  to = from.raw().get<bool>();
}

void read(const JsonValue& from, int64_t& to) {
  const json& value = from.raw();
  const bool fits = value.is_number_integer() &&
                    !(value.is_number_unsigned() && value.get<uint64_t>() > INT64_MAX);
  if (!fits) from.fail("expected an integer");
  to = value.get<int64_t>();
}

void read(const JsonValue& from, uint64_t& to) {
  const json& value = from.raw();
  const bool fits =
      value.is_number_unsigned() || (value.is_number_integer() && value.get<int64_t>() >= 0);
  if (!fits) from.fail("expected an integer of at least 0");
  to = value.get<uint64_t>();
}

void read(const JsonValue& from, int& to) {
  const auto value = from.as<int64_t>();
  if (value < INT32_MIN || value > INT32_MAX) from.fail("expected an integer of 32 bits");
  to = static_cast<int>(value);
}

void read(const JsonValue& from, double& to) {
  if (!from.raw().is_number() || !std::isfinite(from.raw().get<double>())) {
    from.fail("expected a finite number");
  }
  to = from.raw().get<double>();
}

void read(const JsonValue& from, std::string& to) {
  if (!from.raw().is_string()) from.fail("expected a string");
  to = from.raw().get<std::string>();
}

void read(const JsonValue& from, json& to) { to = from.raw(); }

void read(const JsonValue& from, std::filesystem::path& to) { to = from.as<std::string>(); }

}  // namespace tt3d
