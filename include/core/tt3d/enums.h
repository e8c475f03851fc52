#pragma once

#include <array>
#include <string>
#include <string_view>
#include <vector>

#include "tt3d/error.h"

/// Enums with names. An enum has names if a function `enum_names(Enum)` in its namespace returns
/// them. The values count from 0.
namespace tt3d {

template <typename E>
concept NamedEnum = std::is_enum_v<E> && requires(E value) {
  enum_names(value);
};

/// The name of a value in configuration files and records.
template <NamedEnum E>
[[nodiscard]] std::string name_of(E value) {
  return std::string(enum_names(value).at(static_cast<size_t>(value)));
}

/// All names, in the order of the values.
template <NamedEnum E>
[[nodiscard]] std::vector<std::string> names_of() {
  const auto names = enum_names(E{});
  return {names.begin(), names.end()};
}

/// The message "expected one of a, b, c", with the name nearest to `word` if one is near.
[[nodiscard]] std::string expected_one_of(const std::string& word,
                                          const std::vector<std::string>& names);

/// The value with this name. Throws InputError "expected one of ...".
template <NamedEnum E>
[[nodiscard]] E parse_enum(const std::string& name) {
  const std::vector<std::string> names = names_of<E>();
  for (size_t i = 0; i < names.size(); ++i) {
    if (names[i] == name) return static_cast<E>(i);
  }
  throw InputError(expected_one_of(name, names));
}

}  // namespace tt3d
