#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "tt3d/error.h"

/// Typed access to JSON. Every error names the file, the key and the expected type. A struct can be
/// read and written if a function `members(visit, value)` in its namespace names its members:
///
///     template <typename Visit, typename S> requires std::same_as<std::remove_const_t<S>, Point>
///     void members(Visit& visit, S& p) { visit("x", p.x); visit("y", p.y); }
///
/// Numbers, bool, text, optional (null or absent), vector, set, map and structs can be nested.
namespace tt3d {

/// Parses a JSON text; `path` is the file name in errors. Throws InputError with file and line.
[[nodiscard]] nlohmann::json parse_json(const std::string& text, const std::filesystem::path& path);
/// Reads and parses a JSON file. Throws InputError.
[[nodiscard]] nlohmann::json read_json(const std::filesystem::path& path);
/// Writes JSON atomically, indented by one blank, with a newline at the end.
void write_json(const std::filesystem::path& path, const nlohmann::json& value);

/// A value inside a JSON document, and its path in the document.
class JsonValue {
 public:
  /// The whole document of a file. `value` must outlive this object.
  JsonValue(const nlohmann::json& value, std::filesystem::path path)
      : value_(&value), path_(std::move(path)) {}

  [[nodiscard]] const nlohmann::json& raw() const { return *value_; }
  /// "FILE: KEY", for messages.
  [[nodiscard]] std::string where() const;
  /// Throws InputError "FILE: KEY: problem".
  [[noreturn]] void fail(const std::string& problem) const;
  /// True if this object has the member and it is not null. Throws InputError if this is not an
  /// object.
  [[nodiscard]] bool has(const std::string& key) const;
  /// A member of an object; throws InputError if this is not an object or the member is absent.
  [[nodiscard]] JsonValue at(const std::string& key) const;
  /// An element of an array; throws InputError if this is not an array or the index is too large.
  [[nodiscard]] JsonValue at(size_t index) const;
  /// The number of elements; throws InputError if this is not an array.
  [[nodiscard]] size_t size() const;

  /// The value as a T; throws InputError if it has another type.
  template <typename T>
  [[nodiscard]] T as() const {
    T out{};
    read(*this, out);
    return out;
  }
  /// The member as a T, or `fallback` if it is absent or null.
  template <typename T>
  [[nodiscard]] T get(const std::string& key, T fallback) const {
    return has(key) ? at(key).as<T>() : fallback;
  }

 private:
  JsonValue(const nlohmann::json& value, std::filesystem::path path, std::string key)
      : value_(&value), path_(std::move(path)), key_(std::move(key)) {}

  const nlohmann::json* value_;
  std::filesystem::path path_;
  std::string key_;  ///< "victims[2].asr"; "" for the whole document
};

// ---- Reading ------------------------------------------------------------------------------

void read(const JsonValue& from, bool& to);
void read(const JsonValue& from, int& to);
void read(const JsonValue& from, int64_t& to);
void read(const JsonValue& from, uint64_t& to);
/// A finite number.
void read(const JsonValue& from, double& to);
void read(const JsonValue& from, std::string& to);
void read(const JsonValue& from, std::filesystem::path& to);
void read(const JsonValue& from, nlohmann::json& to);

template <typename T>
void read(const JsonValue& from, std::vector<T>& to);
template <typename T>
void read(const JsonValue& from, std::set<T>& to);
template <typename T>
void read(const JsonValue& from, std::map<std::string, T>& to);
template <typename T, size_t N>
void read(const JsonValue& from, std::array<T, N>& to);

/// Reads a struct's members.
class JsonReader {
 public:
  explicit JsonReader(const JsonValue& from) : from_(from) {}
  template <typename T>
  void operator()(const char* key, T& member) {
    read(from_.at(key), member);
  }
  template <typename T>
  void operator()(const char* key, std::optional<T>& member) {
    member.reset();
    if (from_.has(key)) member = from_.at(key).as<T>();
  }
  /// Reads a member; it keeps its value if the key is absent or null.
  template <typename T>
  void optional(const char* key, T& member) {
    if (from_.has(key)) read(from_.at(key), member);
  }

 private:
  const JsonValue& from_;
};

template <typename T>
requires requires(JsonReader& reader, T& value) { members(reader, value); }
void read(const JsonValue& from, T& to) {
  JsonReader reader(from);
  members(reader, to);
}

template <typename T>
void read(const JsonValue& from, std::vector<T>& to) {
  to.clear();
  for (size_t i = 0; i < from.size(); ++i) to.push_back(from.at(i).template as<T>());
}

template <typename T>
void read(const JsonValue& from, std::set<T>& to) {
  to.clear();
  for (size_t i = 0; i < from.size(); ++i) to.insert(from.at(i).template as<T>());
}

template <typename T>
void read(const JsonValue& from, std::map<std::string, T>& to) {
  to.clear();
  if (!from.raw().is_object()) from.fail("expected an object");
  for (const auto& item : from.raw().items()) to[item.key()] = from.at(item.key()).template as<T>();
}

template <typename T, size_t N>
void read(const JsonValue& from, std::array<T, N>& to) {
  if (from.size() != N) from.fail("expected " + std::to_string(N) + " elements");
  for (size_t i = 0; i < N; ++i) read(from.at(i), to[i]);
}

// ---- Writing ------------------------------------------------------------------------------

/// Writes a struct's members.
class JsonWriter {
 public:
  template <typename T>
  void operator()(const char* key, const T& member) {
    object_[key] = to_json_value(member);
  }
  template <typename T>
  void optional(const char* key, const T& member) {
    (*this)(key, member);
  }
  [[nodiscard]] nlohmann::json take() { return std::move(object_); }

  template <typename T>
  [[nodiscard]] static nlohmann::json to_json_value(const T& value) {
    if constexpr (requires(JsonWriter & writer) { members(writer, value); }) {
      JsonWriter writer;
      members(writer, value);
      return writer.take();
    } else if constexpr (std::is_same_v<T, std::filesystem::path>) {
      return value.string();
    } else {
      return value;
    }
  }
  template <typename T>
  [[nodiscard]] static nlohmann::json to_json_value(const std::optional<T>& value) {
    return value ? to_json_value(*value) : nlohmann::json(nullptr);
  }
  template <typename T>
  [[nodiscard]] static nlohmann::json to_json_value(const std::vector<T>& values) {
    nlohmann::json array = nlohmann::json::array();
    for (const T& value : values) array.push_back(to_json_value(value));
    return array;
  }
  template <typename T>
  [[nodiscard]] static nlohmann::json to_json_value(const std::map<std::string, T>& values) {
    nlohmann::json object = nlohmann::json::object();
    for (const auto& [key, value] : values) object[key] = to_json_value(value);
    return object;
  }

 private:
  nlohmann::json object_ = nlohmann::json::object();
};

/// A value as JSON.
template <typename T>
[[nodiscard]] nlohmann::json to_json(const T& value) {
  return JsonWriter::to_json_value(value);
}

/// The content of a JSON file as a T. Throws InputError that names file and key.
template <typename T>
[[nodiscard]] T read_json_as(const std::filesystem::path& path) {
  const nlohmann::json document = read_json(path);
  return JsonValue(document, path).as<T>();
}

}  // namespace tt3d
