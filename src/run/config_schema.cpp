#include "config_schema.h"

#include <algorithm>

namespace tt3d::config {
namespace {

std::string number_text(double x) {
  const std::string text = fmt::format("{}", x);
  return text.find_first_of(".en") == std::string::npos ? text + ".0" : text;
}

std::string toml_string(const std::string& text) {
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') out += '\\';
    out += c;
  }
  return out + "\"";
}

template <typename T>
std::string list_text(const std::vector<T>& list) {
  std::string out = "[";
  for (const T& item : list) {
    if (out.size() > 1) out += ", ";
    if constexpr (std::is_same_v<T, std::string>)
      out += toml_string(item);
    else
      out += number_text(item);
  }
  return out + "]";
}

std::string joined(const std::vector<std::string>& words) {
  std::string out;
  for (const std::string& w : words) out += (out.empty() ? "" : ", ") + w;
  return out;
}

/// "" if the word is one of the choices or there are none; else what was expected.
std::string not_among(const std::string& word, const std::vector<std::string>& choices) {
  if (choices.empty() || std::find(choices.begin(), choices.end(), word) != choices.end()) {
    return "";
  }
  const std::string near = nearest_name(word, choices);
  return "expected one of " + joined(choices) +
         (near.empty() ? "" : "; did you mean '" + near + "'?");
}

}  // namespace

void Schema::number(const std::string& name, double& target, double low, double high,
                    const std::string& unit, const std::string& meaning) {
  const std::string range = fmt::format("{} to {}", low, high);
  add(ConfigKey{name, meaning, unit, range, number_text(target)},
      [&target, low, high, range](const toml::node& node) -> std::string {
        const auto value = node.is_number() ? node.value<double>() : std::nullopt;
        if (!value) return "expected a number";
        if (!(*value >= low && *value <= high)) return "expected " + range;
        target = *value;
        return "";
      });
}

void Schema::text(const std::string& name, std::string& target,
                  const std::vector<std::string>& choices, const std::string& meaning) {
  add(ConfigKey{name, meaning, "", joined(choices), toml_string(target)},
      [&target, choices](const toml::node& node) -> std::string {
        const auto value = node.is_string() ? node.value<std::string>() : std::nullopt;
        if (!value) return "expected a string";
        const std::string problem = not_among(*value, choices);
        if (problem.empty()) target = *value;
        return problem;
      });
}

void Schema::path(const std::string& name, std::filesystem::path& target,
                  const std::string& meaning) {
  add(ConfigKey{name, meaning, "path", "", toml_string(target.string())},
      [&target](const toml::node& node) -> std::string {
        const auto value = node.is_string() ? node.value<std::string>() : std::nullopt;
        if (!value) return "expected a string";
        target = *value;
        return "";
      });
}

void Schema::texts(const std::string& name, std::vector<std::string>& target,
                   const std::vector<std::string>& choices, const std::string& meaning) {
  const std::string range = choices.empty() ? "list of strings" : "list of " + joined(choices);
  add(ConfigKey{name, meaning, "", range, list_text(target)},
      [&target, choices, range](const toml::node& node) -> std::string {
        const toml::array* array = node.as_array();
        if (!array) return "expected a " + range;
        std::vector<std::string> list;
        for (const toml::node& item : *array) {
          const auto value = item.is_string() ? item.value<std::string>() : std::nullopt;
          if (!value) return "expected a " + range;
          const std::string problem = not_among(*value, choices);
          if (!problem.empty()) return problem;
          list.push_back(*value);
        }
        target = list;
        return "";
      });
}

void Schema::shares(const std::string& name, std::vector<double>& target,
                    const std::string& meaning) {
  add(ConfigKey{name, meaning, "", "list of numbers from 0 to 1", list_text(target)},
      [&target](const toml::node& node) -> std::string {
        const toml::array* array = node.as_array();
        if (!array) return "expected a list of numbers";
        std::vector<double> list;
        for (const toml::node& item : *array) {
          const auto value = item.is_number() ? item.value<double>() : std::nullopt;
          if (!value || *value < 0 || *value > 1) return "expected numbers from 0 to 1";
          list.push_back(*value);
        }
        target = list;
        return "";
      });
}

}  // namespace tt3d::config
