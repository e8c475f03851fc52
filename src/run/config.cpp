#include "tt3d/config.h"

#include <toml++/toml.h>

#include <functional>
#include <sstream>

#include "tt3d/core.h"
#include "tt3d/json.h"

namespace tt3d::run {
namespace fs = std::filesystem;
namespace {

/// The key of the preset, which sets other keys.
constexpr const char* kMethod = "attack.method";

// ---- TOML ---------------------------------------------------------------------------------

/// A list of strings or of numbers. Throws InputError for anything else.
KeyValue value_of(const toml::array& array) {
  std::vector<std::string> texts;
  std::vector<double> numbers;
  for (const toml::node& item : array) {
    if (item.is_string())
      texts.push_back(item.value<std::string>().value());
    else if (item.is_number())
      numbers.push_back(item.value<double>().value());
    else
      throw InputError("expected a list of strings or a list of numbers");
  }
  if (!texts.empty() && !numbers.empty()) throw InputError("a list mixes strings and numbers");
  if (!texts.empty()) return texts;
  return numbers;
}

KeyValue value_of(const toml::node& node) {
  if (node.is_boolean()) return node.value<bool>().value();
  if (node.is_integer()) return node.value<int64_t>().value();
  if (node.is_floating_point()) return node.value<double>().value();
  if (node.is_string()) return node.value<std::string>().value();
  if (const toml::array* array = node.as_array()) return value_of(*array);
  throw InputError("expected a boolean, a number, a string or a list");
}

template <typename T>
void insert_value(toml::table& table, const std::string& name, const std::vector<T>& list) {
  toml::array array;
  for (const T& item : list) array.push_back(item);
  table.insert(name, array);
}

template <typename T>
void insert_value(toml::table& table, const std::string& name, const T& value) {
  table.insert(name, value);
}

/// Inserts a value at a dotted key.
void insert(toml::table& table, const std::string& name, const KeyValue& value) {
  const size_t dot = name.find('.');
  if (dot != std::string::npos) {
    toml::table& inner = *table.insert(name.substr(0, dot), toml::table{}).first->second.as_table();
    insert(inner, name.substr(dot + 1), value);
    return;
  }
  std::visit([&](const auto& v) { insert_value(table, name, v); }, value);
}

/// Visits the leaves of a TOML table as dotted keys; arrays are leaves.
void for_each_leaf(const toml::table& table, const std::string& prefix,
                   const std::function<void(const std::string&, const toml::node&)>& visit) {
  for (const auto& [key, node] : table) {
    const std::string name = prefix + std::string(key.str());
    if (const toml::table* inner = node.as_table())
      for_each_leaf(*inner, name + ".", visit);
    else
      visit(name, node);
  }
}

// ---- Setting keys -------------------------------------------------------------------------

/// Checks relations between keys; a range cannot express them.
void check_relations(const RunConfig& c, const std::string& where) {
  const auto fail = [&](const std::string& text) { throw InputError(where + ": " + text); };
  const attack::EotOptions& eot = c.attack.options.eot;
  if (c.field.shape.occupancy % 8 != 0) fail("field.occupancy: expected a multiple of 8");
  if (eot.scale_low > eot.scale_high) {
    fail("attack.eot.scale_low: expected at most attack.eot.scale_high");
  }
  if (eot.jpeg_quality_low > eot.jpeg_quality_high) {
    fail("attack.eot.jpeg_quality_low: expected at most attack.eot.jpeg_quality_high");
  }
  if (eot.plain_background + eot.photograph_background > 1) {
    fail("attack.eot.photograph_background: expected at most 1 together with plain_background");
  }
  if (c.mesh.min_faces > c.mesh.max_faces) fail("mesh.min_faces: expected at most mesh.max_faces");
  for (const auto* g : {&c.field.shape.geometry, &c.field.shape.appearance}) {
    if (g->base > g->finest)
      fail("field: expected the base resolution of a grid to be at most its finest");
  }
}

/// The defaults of the program, changed by a preset.
RunConfig preset_config(const std::string& method) {
  RunConfig config;
  attack::attack_preset(method).change(config.attack.options);
  return config;
}

/// Keys that were not given and still have the value of the old preset get the value of the new
/// one.
void change_preset(RunConfig& config, const std::string& before) {
  RunConfig old_config = preset_config(before), new_config = preset_config(config.attack.method);
  const KeyList own = keys_of(config), old_keys = keys_of(old_config),
                new_keys = keys_of(new_config);
  for (size_t i = 0; i < own.all().size(); ++i) {
    const Key& key = own.all()[i];
    if (key.name == kMethod || config.given.contains(key.name)) continue;
    if (key.get() != old_keys.all()[i].get()) continue;
    key.set(new_keys.all()[i].get());
  }
}

/// Sets one key. Throws InputError "KEY: expected ...".
void set_key(RunConfig& config, const std::string& name, const KeyValue& value) {
  const KeyList keys = keys_of(config);
  const Key& key = keys.find(name);
  const std::string method = config.attack.method;
  try {
    key.set(value);
  } catch (const InputError& error) {
    throw InputError(name + ": " + error.what());
  }
  config.given.insert(name);
  if (name == kMethod) change_preset(config, method);
}

/// Paths in a file are relative to its folder, and so is a background that names a folder.
void resolve_paths(RunConfig& config, const fs::path& folder) {
  const KeyList keys = keys_of(config);
  for (const Key& key : keys.all()) {
    const auto text = key.path ? std::get<std::string>(key.get()) : std::string();
    if (!text.empty() && fs::path(text).is_relative()) {
      key.set(fs::weakly_canonical(folder / text).string());
    }
  }
  std::string& background = config.evaluate.background;
  const bool is_folder = background != "white" && !background.starts_with("#");
  if (is_folder && fs::path(background).is_relative()) background = (folder / background).string();
}

}  // namespace

KeyList keys_of(RunConfig& config) {
  KeyList keys;
  config.keys(keys);
  return keys;
}

RunConfig load_config(const fs::path& path) {
  const std::string bytes = read_file(path);
  RunConfig config;
  toml::table table;
  try {
    table = toml::parse(bytes, path.string());
  } catch (const toml::parse_error& error) {
    throw InputError(path, static_cast<long>(error.source().begin.line),
                     std::string(error.description()));
  }
  for_each_leaf(table, "", [&](const std::string& name, const toml::node& node) {
    try {
      set_key(config, name, value_of(node));
    } catch (const InputError& error) {
      throw InputError(path, static_cast<long>(node.source().begin.line), error.what());
    }
  });
  resolve_paths(config, fs::absolute(path).parent_path());
  check_relations(config, path.string());
  return config;
}

Assignment parse_assignment(const std::string& text) {
  const size_t equals = text.find('=');
  if (equals == std::string::npos || equals == 0) {
    throw InputError("--set " + text + ": expected key=value");
  }
  const std::string name = text.substr(0, equals), value = text.substr(equals + 1);
  try {
    const toml::table table = toml::parse("value = " + value);
    return {name, value_of(*table.get("value"))};
  } catch (const toml::parse_error&) {
    return {name, value};  // a bare word is a string
  }
}

void set_all(RunConfig& config, const std::vector<Assignment>& assignments) {
  for (const Assignment& a : assignments) {
    try {
      set_key(config, a.key, a.value);
    } catch (const InputError& error) {
      throw InputError(std::string("--set ") + error.what());
    }
  }
  check_relations(config, "--set");
}

void set_all(RunConfig& config, const std::vector<std::string>& assignments) {
  std::vector<Assignment> parsed;
  for (const std::string& text : assignments) parsed.push_back(parse_assignment(text));
  set_all(config, parsed);
}

std::string class_of_objective(const RunConfig& config) {
  const bool targeted = config.attack.options.objective.goal == attack::Goal::kTargeted;
  const std::string& name = targeted ? config.attack.target : config.evaluate.true_class;
  if (!name.empty()) return name;
  throw InputError(targeted ? "attack.target: expected a class"
                            : "evaluate.true_class: expected the class of the object, because an "
                              "untargeted attack needs it");
}

// ---- Other forms --------------------------------------------------------------------------

std::string toml_of(const KeyValue& value) {
  toml::table table;
  insert(table, "value", value);
  std::ostringstream text;
  text << toml::node_view<const toml::node>(*table.get("value"));
  return text.str();
}

std::string config_toml(const RunConfig& config) {
  RunConfig copy = config;
  toml::table table;
  const KeyList keys = keys_of(copy);
  for (const Key& key : keys.all()) insert(table, key.name, key.get());
  std::ostringstream text;
  text << table << "\n";
  return text.str();
}

std::map<std::string, nlohmann::json> config_json(const RunConfig& config) {
  RunConfig copy = config;
  std::map<std::string, nlohmann::json> values;
  const KeyList keys = keys_of(copy);
  for (const Key& key : keys.all()) {
    std::visit([&](const auto& v) { values[key.name] = v; }, key.get());
  }
  return values;
}

namespace {

KeyValue value_of(const JsonValue& value) {
  const nlohmann::json& raw = value.raw();
  if (raw.is_boolean()) return raw.get<bool>();
  if (raw.is_number_integer()) return value.as<int64_t>();
  if (raw.is_number()) return value.as<double>();
  if (raw.is_string()) return raw.get<std::string>();
  if (!raw.is_array()) value.fail("expected a boolean, a number, a string or a list");
  if (!raw.empty() && raw[0].is_string()) return value.as<std::vector<std::string>>();
  return value.as<std::vector<double>>();
}

}  // namespace

RunConfig config_from_json(const std::map<std::string, nlohmann::json>& values,
                           const fs::path& path) {
  RunConfig config;
  const KeyList keys = keys_of(config);
  for (const auto& [name, value] : values) {
    try {
      keys.find(name).set(value_of(JsonValue(value, path)));
    } catch (const InputError& error) {
      throw InputError(path, "config." + name + ": " + error.what() +
                                 "; the folder was made by another version, use --restart");
    }
  }
  check_relations(config, path.string());
  return config;
}

}  // namespace tt3d::run
