#include "tt3d/keys.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>

#include "tt3d/core.h"

namespace tt3d {
namespace {

std::string joined(const std::vector<std::string>& words) {
  return fmt::format("{}", fmt::join(words, ", "));
}

/// The value as a T; throws InputError "expected WHAT" if it is something else.
template <typename T>
const T& value_as(const KeyValue& value, const std::string& what) {
  const T* found = std::get_if<T>(&value);
  if (found == nullptr) throw InputError("expected " + what);
  return *found;
}

/// Integers count as numbers.
double number_of(const KeyValue& value, const std::string& what) {
  if (const auto* whole = std::get_if<int64_t>(&value)) return static_cast<double>(*whole);
  return value_as<double>(value, what);
}

/// A text; a class or a folder may be an integer, which TOML does not quote.
std::string text_of(const KeyValue& value) {
  if (const auto* whole = std::get_if<int64_t>(&value)) return std::to_string(*whole);
  return value_as<std::string>(value, "a string");
}

/// An empty list has no element type in TOML and JSON, so it may arrive as a list of numbers.
std::vector<std::string> texts_of(const KeyValue& value, const std::string& what) {
  const auto* numbers = std::get_if<std::vector<double>>(&value);
  if (numbers != nullptr && numbers->empty()) return {};
  return value_as<std::vector<std::string>>(value, what);
}

}  // namespace

const Key& KeyList::find(const std::string& name) const {
  std::vector<std::string> names;
  for (const Key& key : keys_) {
    if (key.name == name) return key;
    names.push_back(key.name);
  }
  const std::string near = nearest_name(name, names);
  throw InputError(
      "unknown key '" + name + "'" +
      (near.empty() ? "; 'tt3d config' lists the keys" : "; did you mean '" + near + "'?"));
}

void KeyList::operator()(const char* name, bool& member, const char* meaning) {
  add({prefix_ + name, meaning, "", "true or false", false, [&member] { return KeyValue(member); },
       [&member](const KeyValue& value) {
         // Older configurations and run folders have 0 or 1.
         const auto* number = std::get_if<int64_t>(&value);
         const bool numeric = number != nullptr && (*number == 0 || *number == 1);
         member = numeric ? *number == 1 : value_as<bool>(value, "true or false");
       }});
}

template <typename T>
void KeyList::integer(const char* name, T& member, KeyRange range, const char* unit,
                      const char* meaning) {
  const std::string text = fmt::format("{:.0f} to {:.0f}", range.low, range.high);
  add({prefix_ + name, meaning, unit, text, false,
       [&member] { return KeyValue(static_cast<int64_t>(member)); },
       [&member, range, text](const KeyValue& value) {
         const int64_t n = value_as<int64_t>(value, "an integer");
         if (static_cast<double>(n) < range.low || static_cast<double>(n) > range.high) {
           throw InputError("expected " + text);
         }
         member = static_cast<T>(n);
       }});
}

void KeyList::operator()(const char* name, int64_t& member, KeyRange range, const char* unit,
                         const char* meaning) {
  integer(name, member, range, unit, meaning);
}

void KeyList::operator()(const char* name, int& member, KeyRange range, const char* unit,
                         const char* meaning) {
  integer(name, member, range, unit, meaning);
}

void KeyList::operator()(const char* name, uint64_t& member, KeyRange range, const char* unit,
                         const char* meaning) {
  integer(name, member, range, unit, meaning);
}

void KeyList::operator()(const char* name, double& member, KeyRange range, const char* unit,
                         const char* meaning) {
  const std::string text = fmt::format("{} to {}", range.low, range.high);
  add({prefix_ + name, meaning, unit, text, false, [&member] { return KeyValue(member); },
       [&member, range, text](const KeyValue& value) {
         const double x = number_of(value, "a number");
         if (!(x >= range.low && x <= range.high)) throw InputError("expected " + text);
         member = x;
       }});
}

void KeyList::operator()(const char* name, std::string& member, const char* meaning) {
  add({prefix_ + name, meaning, "", "", false, [&member] { return KeyValue(member); },
       [&member](const KeyValue& value) { member = text_of(value); }});
}

void KeyList::operator()(const char* name, std::filesystem::path& member, const char* meaning) {
  add({prefix_ + name, meaning, "path", "", true, [&member] { return KeyValue(member.string()); },
       [&member](const KeyValue& value) { member = text_of(value); }});
}

void KeyList::operator()(const char* name, std::vector<std::string>& member, const char* meaning) {
  add({prefix_ + name, meaning, "", "list of strings", false,
       [&member] { return KeyValue(member); },
       [&member](const KeyValue& value) { member = texts_of(value, "a list of strings"); }});
}

void KeyList::operator()(const char* name, std::vector<double>& member, KeyRange range,
                         const char* meaning) {
  const std::string text = fmt::format("list of numbers from {} to {}", range.low, range.high);
  add({prefix_ + name, meaning, "", text, false, [&member] { return KeyValue(member); },
       [&member, range, text](const KeyValue& value) {
         const auto& list = value_as<std::vector<double>>(value, "a " + text);
         for (const double x : list) {
           if (!(x >= range.low && x <= range.high)) throw InputError("expected a " + text);
         }
         member = list;
       }});
}

void KeyList::choice(const char* name, const std::vector<std::string>& names, const char* meaning,
                     const std::function<std::string()>& get,
                     const std::function<void(const std::string&)>& set) {
  add({prefix_ + name, meaning, "", joined(names), false, [get] { return KeyValue(get()); },
       [set](const KeyValue& value) { set(value_as<std::string>(value, "a string")); }});
}

void KeyList::choices(const char* name, const std::vector<std::string>& names, const char* meaning,
                      const std::function<std::vector<std::string>()>& get,
                      const std::function<void(const std::vector<std::string>&)>& set) {
  const std::string text = "list of " + joined(names);
  add({prefix_ + name, meaning, "", text, false, [get] { return KeyValue(get()); },
       [set, text](const KeyValue& value) { set(texts_of(value, "a " + text)); }});
}

void KeyList::one_of(const char* name, std::string& member, const std::vector<std::string>& names,
                     const char* meaning) {
  choice(
      name, names, meaning, [&member] { return member; },
      [&member, names](const std::string& text) {
        if (std::find(names.begin(), names.end(), text) == names.end()) {
          throw InputError(expected_one_of(text, names));
        }
        member = text;
      });
}

}  // namespace tt3d
