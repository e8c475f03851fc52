#include <fmt/format.h>

#include <toml++/toml.h>
#include <cmath>
#include <functional>
#include <limits>

#include "tt3d/run.h"

namespace tt3d {
namespace {

constexpr const char* kMethod = "attack.method";

using Read = std::function<std::string(const toml::node&)>;

/// A key bound to its place in a configuration: how to read it and how to write it.
struct Binding {
  ConfigKey key;
  /// Returns "" or what was expected.
  Read read;
};

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

/// Builds the list of keys over a configuration. The one place that knows them all.
class Schema {
 public:
  explicit Schema(RunConfig& c) {
    integer("seed", c.seed, 0, 1e15, "", "seed of every random stream");
    capture_keys(c);
    field_keys(c);
    mesh_keys(c);
    attack_keys(c);
    eot_keys(c);
    bake_and_evaluate_keys(c);
  }
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

  /// A text; with choices, one of them.
  void text(const std::string& name, std::string& target, const std::vector<std::string>& choices,
            const std::string& meaning) {
    add(ConfigKey{name, meaning, "", joined(choices), toml_string(target)},
        [&target, choices](const toml::node& node) -> std::string {
          const auto value = node.is_string() ? node.value<std::string>() : std::nullopt;
          if (!value) return "expected a string";
          const std::string problem = not_among(*value, choices);
          if (problem.empty()) target = *value;
          return problem;
        });
  }

  void path(const std::string& name, std::filesystem::path& target, const std::string& meaning) {
    add(ConfigKey{name, meaning, "path", "", toml_string(target.string())},
        [&target](const toml::node& node) -> std::string {
          const auto value = node.is_string() ? node.value<std::string>() : std::nullopt;
          if (!value) return "expected a string";
          target = *value;
          return "";
        });
  }

  /// A list of texts; with choices, of some of them.
  void texts(const std::string& name, std::vector<std::string>& target,
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

  void shares(const std::string& name, std::vector<double>& target, const std::string& meaning) {
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

  void add(ConfigKey key, Read read) { bindings.push_back({std::move(key), std::move(read)}); }

  void capture_keys(RunConfig& c) {
    path("capture.path", c.capture.path, "folder of the photographs and their cameras");
    text("capture.format", c.capture.format, {"auto", "nerf-synthetic", "nerfstudio", "colmap"},
         "file format of the cameras");
    integer("capture.max_size", c.capture.max_size, 0, 16384, "pixels",
            "photographs are reduced to this longer side; 0 keeps them");
    integer("capture.max_train_views", c.capture.max_train_views, 0, 1e6, "",
            "evenly spaced subset of the training views; 0 takes all");
    integer("capture.max_test_views", c.capture.max_test_views, 0, 1e6, "",
            "evenly spaced subset of the test views; 0 takes all");
  }

  void field_keys(RunConfig& c) {
    FieldOptions& f = c.field;
    for (auto* grid : {&f.shape.geometry, &f.shape.appearance}) {
      const std::string name = grid == &f.shape.geometry ? "field.geometry." : "field.appearance.";
      integer(name + "levels", grid->levels, 1, 32, "", "levels of the hash grid");
      integer(name + "base", grid->base, 2, 512, "cells", "resolution of its coarsest level");
      integer(name + "finest", grid->finest, 2, 65536, "cells", "resolution of its finest level");
      integer(name + "log2_size", grid->log2_size, 8, 24, "",
              "log2 of the entries a level at most");
    }
    integer("field.occupancy", f.shape.occupancy, 16, 512, "cells",
            "side of the occupancy grid, a multiple of 8");
    integer("field.steps", f.steps, 1, 1e7, "", "training steps");
    integer("field.samples_per_step", f.samples_per_step, 1024, 1 << 24, "",
            "samples a step takes");
    integer("field.ray_steps", f.ray_steps, 16, 8192, "", "steps across the box's diagonal");
    number("field.rate", f.rate, 1e-7, 1, "", "Adam's learning rate at its peak");
    integer("field.warmup", f.warmup, 0, 1e6, "steps",
            "linear warm-up, at most a tenth of all steps");
    number("field.diffuse_share", f.diffuse_share, 0, 1, "",
           "share of the steps with diffuse colour only");
    number("field.mask_weight", f.mask_weight, 0, 1e6, "", "weight of the mask loss");
    number("field.specular_weight", f.specular_weight, 0, 1e6, "",
           "weight of the specular part's square");
    number("field.tv_weight", f.tv_weight, 0, 1e6, "", "weight of total variation on the grids");
    integer("field.checkpoint_every", f.checkpoint_every, 1, 1e7, "steps",
            "steps between checkpoints");
  }

  void mesh_keys(RunConfig& c) {
    MeshOptions& m = c.mesh;
    integer("mesh.resolution", m.resolution, 16, 1024, "points", "side of the marching-cubes grid");
    number("mesh.iso", m.iso, 1e-3, 1e6, "", "density of the surface, at most the field's mean");
    integer("mesh.close_gaps", m.close_gaps, 0, 16, "points",
            "cavities and tunnels too narrow for a cube of 2 n + 1 grid points are filled");
    number("mesh.min_component", m.min_component, 0, 1, "",
           "components below this share of the diameter go");
    integer("mesh.target_faces", m.target_faces, 100, 5e6, "faces", "faces after simplification");
    integer("mesh.min_faces", m.min_faces, 0, 5e6, "faces", "refinement does not thin below this");
    integer("mesh.max_faces", m.max_faces, 100, 1e7, "faces",
            "refinement does not split beyond this");
    integer("mesh.refine_steps", m.refine_steps, 0, 1e6, "", "refinement steps");
    integer("mesh.views_per_step", m.views_per_step, 1, 64, "", "photographs a refinement step");
    number("mesh.vertex_rate", m.vertex_rate, 0, 1, "", "learning rate of vertex offsets");
    number("mesh.appearance_rate", m.appearance_rate, 0, 1, "", "learning rate of the appearance");
    number("mesh.mask_weight", m.mask_weight, 0, 1e6, "", "weight of the mask loss");
    number("mesh.laplacian_weight", m.laplacian_weight, 0, 1e6, "",
           "weight of the uniform Laplacian");
    number("mesh.offset_weight", m.offset_weight, 0, 1e6, "", "weight of the offsets' square");
    shares("mesh.remesh_at", m.remesh_at,
           "shares of the steps at which faces are split and thinned");
    number("mesh.split_share", m.split_share, 0, 1, "",
           "share of faces, worst error first, that is split");
    number("mesh.decimate_share", m.decimate_share, 0, 1, "",
           "share of faces, best error first, that is thinned");
    number("mesh.decimate_ratio", m.decimate_ratio, 0.01, 1, "", "share of those that is kept");
    number("mesh.min_edge", m.min_edge, 0, 1, "object box / 2", "edges are not split below this");
    integer("mesh.checkpoint_every", m.checkpoint_every, 1, 1e7, "steps",
            "steps between checkpoints");
  }

  void attack_keys(RunConfig& c) {
    AttackOptions& a = c.attack;
    text(kMethod, c.attack_method, attack_preset_names(),
         "preset of the keys below ('tt3d attack --list')");
    texts("attack.optimize", a.optimize, attack_parts(), "parts of the object that may change");
    text("attack.target", c.attack_target, {},
         "target class: index, WordNet id or name; an untargeted attack needs none");
    texts("attack.surrogates", c.attack_surrogates, {}, "models the attack may see");
    text("attack.objective", a.objective, objective_names(), "loss on the surrogates' logits");
    number("attack.sticker_area", a.sticker_area, 0, 1, "",
           "share of the surface where colours are free, a round patch; 0: all of it");
    number("attack.sticker_azimuth_deg", a.sticker_azimuth_deg, -360, 360, "degrees",
           "side of the object that the patch sits on");
    number("attack.sticker_elevation_deg", a.sticker_elevation_deg, -90, 90, "degrees",
           "its height on the object");
    text("attack.goal", a.goal, goal_names(), "towards the target, or away from the true class");
    text("attack.ensemble", a.ensemble, ensemble_names(), "what is averaged over the surrogates");
    number("attack.beta", a.beta, 0, 1e9, "", "strength of naturalness (paper: 1e3)");
    number("attack.rgb_weight", a.rgb_weight, 0, 1e9, "", "l1, weight of R_rgb");
    number("attack.chamfer_weight", a.chamfer_weight, 0, 1e9, "", "l2, weight of R_cd");
    number("attack.laplacian_weight", a.laplacian_weight, 0, 1e9, "", "l3, weight of R_lap");
    number("attack.edge_weight", a.edge_weight, 0, 1e9, "", "l4, weight of R_edge");
    number("attack.psnr_floor", a.psnr_floor, 0, 99, "dB",
           "R_rgb counts only beyond the error of this PSNR; 0: always, as in the paper");
    number("attack.ssim_floor", a.ssim_floor, 0, 1, "",
           "what SSIM to the clean pictures lacks to this counts, too; 0: nothing");
    number("attack.ssim_weight", a.ssim_weight, 0, 1e9, "", "weight of what SSIM lacks");
    text("attack.laplacian", a.laplacian, laplacian_names(), "weights of a vertex's neighbours");
    number("attack.displacement_weight", a.displacement_weight, 0, 1e9, "",
           "weight of how much neighbours move apart (MeshAdv)");
    number("attack.variation_weight", a.variation_weight, 0, 1e9, "",
           "weight of the total variation of what was changed");
    number("attack.printability_weight", a.printability_weight, 0, 1e9, "",
           "weight of the distance to printable colours");
    path("attack.printer_colors", a.printer_colors,
         "file of the printable colours, three numbers from 0 to 1 a line");
    number("attack.max_displacement", a.max_displacement, 0, 1, "object box / 2",
           "no vertex moves further; 0: no bound");
    integer("attack.steps", a.steps, 1, 1e7, "", "optimisation steps");
    integer("attack.views_per_step", a.views_per_step, 1, 256, "", "fresh views a step");
    integer("attack.image_size", a.image_size, 16, 4096, "pixels", "side of the rendered pictures");
    text("attack.view_distribution", a.view_distribution, view_distribution_names(),
         "where views are drawn from");
    number("attack.appearance_rate", a.appearance_rate, 0, 1, "", "learning rate of the look");
    number("attack.vertex_rate", a.vertex_rate, 0, 1, "", "learning rate of vertex offsets");
    number("attack.final_rate", a.final_rate, 1e-4, 1, "", "share of the rates left at the end");
    text("attack.schedule", a.schedule, schedule_names(), "the rates' way there");
    number("attack.momentum", a.momentum, 0, 1, "",
           "share of past gradients in each direction, beside Adam's; 0: none");
    integer("attack.checkpoint_every", a.checkpoint_every, 1, 1e7, "steps",
            "steps between checkpoints");
  }

  void eot_keys(RunConfig& c) {
    EotOptions& e = c.attack.eot;
    number("attack.eot.object_shift", e.object_shift, 0, 1, "object radii",
           "shift of the object along each axis, each way; 0 switches it off, as in all below");
    number("attack.eot.scale_low", e.scale_low, 0.05, 4, "",
           "smallest size of the picture in the frame");
    number("attack.eot.scale_high", e.scale_high, 0.05, 4, "",
           "largest size of the picture in the frame");
    number("attack.eot.shift", e.shift, 0, 1, "frame sides", "place in the frame, each way");
    number("attack.eot.rotation_deg", e.rotation_deg, 0, 180, "degrees",
           "in-plane rotation, each way");
    number("attack.eot.brightness", e.brightness, 0, 1, "", "factor 1 - b to 1 + b");
    number("attack.eot.contrast", e.contrast, 0, 1, "", "factor 1 - c to 1 + c");
    number("attack.eot.saturation", e.saturation, 0, 1, "", "factor 1 - s to 1 + s");
    number("attack.eot.blur", e.blur, 0, 10, "pixels", "largest sigma of Gaussian blur");
    number(
        "attack.eot.resolution", e.resolution, 0.05, 1, "",
        "pictures go down to this share of the pixels a side, or less far, and up again; 1: off");
    number("attack.eot.noise", e.noise, 0, 1, "", "largest sigma of Gaussian noise");
    number("attack.eot.jpeg", e.jpeg, 0, 1, "", "share of pictures that pass through JPEG");
    integer("attack.eot.jpeg_quality_low", e.jpeg_quality_low, 1, 100, "",
            "worst quality of these");
    integer("attack.eot.jpeg_quality_high", e.jpeg_quality_high, 1, 100, "",
            "best quality of these");
    number("attack.eot.mix", e.mix, 0, 1, "",
           "share of a photograph that is added to each picture");
    number("attack.eot.diversity", e.diversity, 0, 1, "",
           "share of pictures that are shrunk and padded with black");
    number("attack.eot.diversity_low", e.diversity_low, 0.1, 1, "", "smallest size of these");
    number("attack.eot.plain_background", e.plain_background, 0, 1, "",
           "share of pictures on a random plain colour");
    number("attack.eot.photograph_background", e.photograph_background, 0, 1, "",
           "share of pictures on a photograph; the rest on white");
    path("attack.eot.photographs", e.photographs,
         "folder of the photographs for backgrounds and mix");
  }

  void bake_and_evaluate_keys(RunConfig& c) {
    integer("bake.resolution", c.bake_resolution, 64, 16384, "texels", "side of the texture");
    integer("bake.padding", c.bake_padding, 0, 64, "texels", "space between charts");
    number("bake.unwrap_time_limit", c.unwrap_time_limit, 1, 1e5, "seconds",
           "time limit of the unwrap");
    text("evaluate.true_class", c.true_class, {},
         "class of the object, what an untargeted attack leads away from; empty: no accuracy "
         "figures");
    texts("evaluate.victims", c.victims, {}, "models that are scored");
    integer("evaluate.views", c.evaluate_views, 1, 1e6, "", "held-out random views");
    text("evaluate.view_distribution", c.evaluate_distribution, view_distribution_names(),
         "where views are drawn from");
    integer("evaluate.size", c.evaluate_size, 16, 8192, "pixels", "side of the pictures");
    text("evaluate.background", c.evaluate_background, {},
         "white, #rrggbb or a folder of photographs");
  }
};

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
  for (std::filesystem::path* p :
       {&config.capture.path, &config.attack.eot.photographs, &config.attack.printer_colors}) {
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
