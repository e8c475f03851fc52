#pragma once

#include <fmt/format.h>
#include <toml++/toml.h>

#include <functional>

#include "tt3d/run.h"

/// The keys of a configuration: what each is called, means and takes, and where its value goes.
namespace tt3d::config {

/// The preset's key: other keys follow it.
inline constexpr const char* kMethod = "attack.method";

using Read = std::function<std::string(const toml::node&)>;

/// A key bound to its place in a configuration: how to read it and how to write it.
struct Binding {
  ConfigKey key;
  /// Returns "" or what was expected.
  Read read;
};

/// Builds the list of keys over a configuration; config_keys.cpp alone knows them all.
class Schema {
 public:
  explicit Schema(RunConfig& c);
  std::vector<Binding> bindings;

 private:
  template <typename T>
  void integer(const std::string& name, T& target, double low, double high, const std::string& unit,
               const std::string& meaning) {
    const std::string range = fmt::format("{:.0f} to {:.0f}", low, high);
    add(ConfigKey{name, meaning, unit, range, fmt::format("{}", target)},
        [&target, low, high, range](const toml::node& node) -> std::string {
          const auto value = node.is_integer() ? node.value<int64_t>() : std::nullopt;
          if (!value) return "expected an integer";
          if (static_cast<double>(*value) < low || static_cast<double>(*value) > high) {
            return "expected " + range;
          }
          target = static_cast<T>(*value);
          return "";
        });
  }

  void number(const std::string& name, double& target, double low, double high,
              const std::string& unit, const std::string& meaning);
  /// A text; with choices, one of them.
  void text(const std::string& name, std::string& target, const std::vector<std::string>& choices,
            const std::string& meaning);
  void path(const std::string& name, std::filesystem::path& target, const std::string& meaning);
  /// A list of texts; with choices, of some of them.
  void texts(const std::string& name, std::vector<std::string>& target,
             const std::vector<std::string>& choices, const std::string& meaning);
  void shares(const std::string& name, std::vector<double>& target, const std::string& meaning);
  void add(ConfigKey key, Read read) { bindings.push_back({std::move(key), std::move(read)}); }

  void capture_keys(RunConfig& c);
  void field_keys(RunConfig& c);
  void mesh_keys(RunConfig& c);
  void attack_keys(RunConfig& c);
  void eot_keys(RunConfig& c);
  void bake_and_evaluate_keys(RunConfig& c);
};

}  // namespace tt3d::config
