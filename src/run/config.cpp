#include <toml++/toml.h>

#include <functional>

#include "config_schema.h"

namespace tt3d {
namespace {

using config::Binding;
using config::kMethod;
using config::Schema;

std::vector<std::string> names_of(const Schema& schema) {
  std::vector<std::string> names;
  for (const Binding& b : schema.bindings) names.push_back(b.key.name);
  return names;
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

/// Relations between keys that no single range can hold.
void check_relations(const RunConfig& c, const std::string& where) {
  const auto fail = [&](const std::string& text) { throw InputError(where + ": " + text); };
  if (c.field.shape.occupancy % 8 != 0) fail("field.occupancy: expected a multiple of 8");
  if (c.attack.eot.scale_low > c.attack.eot.scale_high) {
    fail("attack.eot.scale_low: expected at most attack.eot.scale_high");
  }
  if (c.attack.eot.jpeg_quality_low > c.attack.eot.jpeg_quality_high) {
    fail("attack.eot.jpeg_quality_low: expected at most attack.eot.jpeg_quality_high");
  }
  if (c.attack.eot.plain_background + c.attack.eot.photograph_background > 1) {
    fail("attack.eot.photograph_background: expected at most 1 together with plain_background");
  }
  if (c.mesh.min_faces > c.mesh.max_faces) fail("mesh.min_faces: expected at most mesh.max_faces");
  for (const auto* g : {&c.field.shape.geometry, &c.field.shape.appearance}) {
    if (g->base > g->finest) fail("field: base resolution of a grid exceeds its finest");
  }
}

std::string unknown_key(const std::string& name, const Schema& schema) {
  const std::string near = nearest_name(name, names_of(schema));
  return "unknown key '" + name + "'" +
         (near.empty() ? "; 'tt3d config' lists the keys" : "; did you mean '" + near + "'?");
}

/// A key's value as TOML, read back.
toml::table parse_value(const std::string& text) { return toml::parse("value = " + text); }

/// The program's defaults with a preset's changes.
RunConfig preset_config(const std::string& method) {
  RunConfig config;
  attack_preset(method).change(config.attack);
  return config;
}

/// Keys that still have what the old preset gave them, and that nobody gave, follow the new one.
void change_preset(RunConfig& config, const std::string& before) {
  RunConfig old_values = preset_config(before), new_values = preset_config(config.attack_method);
  const Schema own(config), old_schema(old_values), new_schema(new_values);
  for (size_t i = 0; i < own.bindings.size(); ++i) {
    const ConfigKey& key = own.bindings[i].key;
    if (key.name == kMethod || config.given.contains(key.name)) continue;
    if (key.value != old_schema.bindings[i].key.value) continue;
    const toml::table value = parse_value(new_schema.bindings[i].key.value);
    (void)own.bindings[i].read(*value.get("value"));
  }
}

void apply(RunConfig& config, const std::string& name, const toml::node& node,
           const std::function<void(const std::string&)>& fail) {
  const Schema schema(config);
  for (const Binding& binding : schema.bindings) {
    if (binding.key.name != name) continue;
    const std::string method = config.attack_method;
    const std::string problem = binding.read(node);
    if (!problem.empty()) fail(name + ": " + problem);
    config.given.insert(name);
    if (name == kMethod) change_preset(config, method);
    return;
  }
  fail(unknown_key(name, schema));
}

void apply_assignment(RunConfig& config, const std::string& assignment) {
  const size_t equals = assignment.find('=');
  if (equals == std::string::npos || equals == 0) {
    throw InputError("--set " + assignment + ": expected key=value");
  }
  const std::string name = assignment.substr(0, equals), value = assignment.substr(equals + 1);
  const auto fail = [&](const std::string& problem) { throw InputError("--set " + problem); };
  toml::table table;
  try {
    table = parse_value(value);
  } catch (const toml::parse_error&) {
    table = toml::table{{"value", value}};  // a bare word
  }
  apply(config, name, *table.get("value"), fail);
}

}  // namespace

RunConfig::RunConfig() {
  for (HashGridShape* grid : {&field.shape.geometry, &field.shape.appearance}) {
    grid->finest = 1024;
    grid->log2_size = 17;
  }
  field.steps = 450;
  field.samples_per_step = int64_t{1} << 16;
  field.ray_steps = 512;
  mesh.resolution = 192;
  mesh.refine_steps = 200;
  attack.steps = 450;
  attack.objective = "logit";
  attack.image_size = 224;
  attack.psnr_floor = 21.5;
  attack.ssim_floor = 0.82;
  capture.max_size = 400;
}

std::vector<ConfigKey> config_keys(const RunConfig& config) {
  RunConfig copy = config;
  std::vector<ConfigKey> keys;
  for (const Binding& b : Schema(copy).bindings) keys.push_back(b.key);
  return keys;
}

RunConfig load_config(const std::filesystem::path& path) {
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
    apply(config, name, node, [&](const std::string& problem) {
      throw InputError(path, static_cast<long>(node.source().begin.line), problem);
    });
  });
  const auto beside = std::filesystem::absolute(path).parent_path();
  for (std::filesystem::path* p : {&config.asset, &config.capture.path, &config.attack.sticker_mask,
                                   &config.attack.eot.photographs, &config.attack.printer_colors}) {
    if (!p->empty() && p->is_relative()) *p = std::filesystem::weakly_canonical(beside / *p);
  }
  const bool folder =
      config.evaluate_background != "white" && !config.evaluate_background.starts_with("#");
  if (folder && std::filesystem::path(config.evaluate_background).is_relative()) {
    config.evaluate_background = (beside / config.evaluate_background).string();
  }
  check_relations(config, path.string());
  return config;
}

void set_all(RunConfig& config, const std::vector<std::string>& assignments) {
  for (const std::string& a : assignments) apply_assignment(config, a);
  check_relations(config, "--set");
}

void set_config(RunConfig& config, const std::string& assignment) { set_all(config, {assignment}); }

std::string config_toml(const RunConfig& config) {
  std::string out, section;
  for (const ConfigKey& key : config_keys(config)) {
    const size_t dot = key.name.rfind('.');
    const std::string own = dot == std::string::npos ? "" : key.name.substr(0, dot);
    if (own != section) {
      out += "\n[" + own + "]\n";
      section = own;
    }
    out +=
        (dot == std::string::npos ? key.name : key.name.substr(dot + 1)) + " = " + key.value + "\n";
  }
  return out;
}

}  // namespace tt3d
