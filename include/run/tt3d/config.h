#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <vector>

#include "tt3d/asset.h"
#include "tt3d/attack.h"
#include "tt3d/capture.h"
#include "tt3d/evaluate.h"
#include "tt3d/field.h"
#include "tt3d/keys.h"
#include "tt3d/mesh.h"

/// The configuration of a run: every options struct of its stages. `tt3d config` lists the keys.
namespace tt3d::run {

/// The asset that a run attacks in place of a capture.
struct AssetInput {
  std::filesystem::path path;
  void keys(KeyList& key) {
    key("path", path, "textured mesh (GLB, glTF, OBJ), attacked in place of a capture");
  }
};

/// The attack: preset, class, models, and its options.
struct AttackConfig {
  std::string method = "dual";
  std::string target;
  std::vector<std::string> surrogates;
  std::vector<std::string> also;
  attack::AttackOptions options;

  void keys(KeyList& key) {
    key.one_of("method", method, attack::attack_preset_names(),
               "preset: sets other keys of this table ('tt3d attack --list' lists the presets)");
    key("target", target,
        "target class: index, WordNet id or name; an untargeted attack needs none");
    key("surrogates", surrogates, "models that the attack may use");
    key("also", also,
        "run folders of further objects that share the same tile: a universal attack");
    options.keys(key);
  }
};

/// All options of a run. The defaults are the method of the paper at a size that takes minutes on
/// two CPU cores; configs/paper.toml and the preset "paper" have the settings of the official code.
struct RunConfig {
  uint64_t seed = 0;
  AssetInput asset;
  capture::CaptureOptions capture;
  field::FieldOptions field;
  mesh::MeshOptions mesh;
  AttackConfig attack;
  asset::BakeOptions bake;
  evaluate::EvaluateOptions evaluate;

  /// Keys that a file or an assignment set; a preset does not change them.
  std::set<std::string> given;

  void keys(KeyList& key) {
    key("seed", seed, {0, 1e15}, "", "seed of every random stream");
    key.group("asset", asset);
    key.group("capture", capture);
    key.group("field", field);
    key.group("mesh", mesh);
    key.group("attack", attack);
    key.group("bake", bake);
    key.group("evaluate", evaluate);
  }
};

/// The keys of a configuration, bound to its members.
[[nodiscard]] KeyList keys_of(RunConfig& config);

/// Reads a TOML file; keys that it does not set keep their defaults. Relative paths are relative to
/// the file. Throws InputError with file, line and key: unknown keys (with the nearest valid key),
/// wrong types, values out of range.
[[nodiscard]] RunConfig load_config(const std::filesystem::path& path);

/// One key and its new value.
struct Assignment {
  std::string key;
  KeyValue value;
};
/// Parses the argument "key=value" of --set. The value is TOML; a bare word is a string.
[[nodiscard]] Assignment parse_assignment(const std::string& text);
/// Sets keys. attack.method also applies its preset to all keys that are not given, in any order.
/// Relations between keys are checked at the end only. Throws InputError.
void set_all(RunConfig& config, const std::vector<Assignment>& assignments);
/// The same for arguments of --set.
void set_all(RunConfig& config, const std::vector<std::string>& assignments);

/// The class of the objective: the target class or, untargeted, the true class. Throws InputError
/// if the configuration does not name it.
[[nodiscard]] std::string class_of_objective(const RunConfig& config);

/// The value of a key as TOML.
[[nodiscard]] std::string toml_of(const KeyValue& value);
/// The whole configuration as TOML.
[[nodiscard]] std::string config_toml(const RunConfig& config);
/// Converts the whole configuration to typed JSON values by key, and back. Throws InputError that
/// begins with `path`.
[[nodiscard]] std::map<std::string, nlohmann::json> config_json(const RunConfig& config);
[[nodiscard]] RunConfig config_from_json(const std::map<std::string, nlohmann::json>& values,
                                         const std::filesystem::path& path);

}  // namespace tt3d::run
