#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "tt3d/attack.h"
#include "tt3d/bake.h"
#include "tt3d/capture.h"
#include "tt3d/core.h"
#include "tt3d/evaluate.h"
#include "tt3d/field.h"
#include "tt3d/mesh.h"
#include "tt3d/report.h"

/// The main job: a configuration, a run folder, and the stages between them.
namespace tt3d {

// ---- Configuration ------------------------------------------------------------------------

/// Everything a run can be told; `tt3d config` lists the keys.
struct RunConfig {
  /// The program's defaults: the paper's method at a size that two CPU cores finish in minutes.
  /// configs/paper.toml and the preset "paper" have the official code's numbers.
  RunConfig();

  uint64_t seed = 0;
  CaptureOptions capture;
  std::filesystem::path asset;  ///< attacked in place of a capture
  FieldOptions field;
  MeshOptions mesh;
  std::string attack_method = "dual";  ///< preset that `attack` follows
  AttackOptions attack;
  std::string attack_target;
  std::vector<std::string> attack_surrogates;
  std::vector<std::string> attack_also;  ///< run folders of further objects
  int bake_resolution = 2048;
  int bake_padding = 4;
  double unwrap_time_limit = 300;
  std::string true_class;
  std::vector<std::string> victims;
  int64_t evaluate_views = 100;
  std::string evaluate_distribution = "dome";
  int evaluate_size = 400;
  std::string evaluate_background = "white";
  int evaluate_samples = 1;   ///< rays a pixel, a square number
  int evaluate_geometry = 0;  ///< 1: also shapes against the clean object

  /// Keys that a file or an assignment gave: another preset leaves them alone.
  std::set<std::string> given;
};

/// One documented key.
struct ConfigKey {
  std::string name, meaning, unit, range;
  std::string value;  ///< as TOML
};

/// Every key with its value in `config`, in order.
[[nodiscard]] std::vector<ConfigKey> config_keys(const RunConfig& config);

/// Reads a TOML file over the defaults. Relative paths are relative to the file. Throws InputError
/// with file, line and key: unknown keys (with the nearest valid one), wrong types, values out of
/// range.
[[nodiscard]] RunConfig load_config(const std::filesystem::path& path);
/// Applies "key=value" as --set gives it; the value is TOML, a bare word counts as a string.
/// attack.method also brings its preset's values to the keys that were not given, before or after.
void set_config(RunConfig& config, const std::string& assignment);
/// All of them; relations between keys need to hold at the end only.
void set_all(RunConfig& config, const std::vector<std::string>& assignments);
/// The class that the attack leads to or, untargeted, away from. Throws InputError where the
/// configuration does not name it.
[[nodiscard]] std::string class_of_objective(const RunConfig& config);
/// The whole configuration as TOML.
[[nodiscard]] std::string config_toml(const RunConfig& config);

// ---- Run folder ---------------------------------------------------------------------------

/// A finished stage.
struct StageRecord {
  std::string name;
  double seconds = 0;
  int64_t peak_rss_bytes = 0;
};

/// Where an object stands: the frame of its views, normalised, and the way from the input's
/// coordinates into it.
struct Scene {
  ViewFrame frame;
  Normalization normalization;
};

/// A run folder (design, section 7). Holds a lock, so that two programs never share one.
class Run {
 public:
  /// Opens or creates the folder for `config`. A folder that was made with another configuration is
  /// refused with the differing keys named, unless `restart`, which empties it.
  Run(const std::filesystem::path& folder, const RunConfig& config, bool restart);
  /// Opens a folder that exists, with the configuration it was made with.
  static Run open(const std::filesystem::path& folder);

  [[nodiscard]] const RunConfig& config() const { return config_; }
  [[nodiscard]] const std::filesystem::path& folder() const { return folder_; }
  [[nodiscard]] const std::vector<StageRecord>& stages() const { return stages_; }
  /// Where the stages compute; the CPU unless said otherwise. Not part of the configuration: a run
  /// may go on on another device.
  void use_device(at::Device device) { device_ = device; }
  /// Changes keys and forgets `first_stage` and all stages after it.
  void reconfigure(const std::vector<std::string>& assignments, const std::string& first_stage);

  /// The stage counts as not done; what it made stays until it has run again.
  void forget(const std::string& stage);

  /// Names of the stages, in order: field, mesh, attack, bake, evaluate, report.
  static const std::vector<std::string>& stage_names();
  /// Runs the stages up to and including `last` that are not done. Throws whatever they throw.
  void run_until(const std::string& last, Progress& progress);
  /// Whether a stage ran to its end and its product is still there.
  [[nodiscard]] bool done(const std::string& stage) const;

 private:
  Run() = default;
  void lock();
  void save() const;
  void load_stages();
  void run_stage(const std::string& name, Progress& progress);
  /// Enters a finished stage into the record.
  void record(const StageRecord& finished);
  void run_field(Progress& progress);
  void run_mesh(Progress& progress);
  void take_asset(Progress& progress);
  void run_attack_stage(Progress& progress);
  void run_bake(Progress& progress);
  void run_evaluate(Progress& progress);
  void run_report(Progress& progress);
  const Capture& capture(Progress& progress);
  [[nodiscard]] Scene scene(Progress& progress);
  /// The clean object as an attack begins with it; models aside.
  [[nodiscard]] AttackInput attack_input(Progress& progress);
  void save_attack_files(const AttackResult& result) const;
  /// Takes over what another run's universal attack made of this object.
  void adopt_attack(const Run& from, const AttackResult& result);
  /// The clean mesh's map, cut once and kept beside it.
  [[nodiscard]] Atlas atlas(const TriMesh& mesh) const;

  std::filesystem::path folder_;
  RunConfig config_;
  at::Device device_ = at::kCPU;
  std::vector<StageRecord> stages_;
  std::map<std::string, std::string> input_hashes_;
  std::shared_ptr<Capture> capture_;
  std::shared_ptr<void> lock_;  ///< released when the last copy of the run goes
};

/// The records (JSON text) of a folder by kind, each kind by file name.
struct RecordTexts {
  std::vector<std::string> evaluations;       ///< of `tt3d evaluate`
  std::vector<std::string> judges;            ///< of `tt3d judge`
  std::vector<std::filesystem::path> videos;  ///< files of `tt3d video-score`
};

/// Reads a folder's records but the file `without`; other JSON is left out.
[[nodiscard]] RecordTexts records_in(const std::filesystem::path& folder,
                                     const std::string& without = "");

/// A record of `tt3d video-score` with the pictures beside it; without their folder only the
/// record. Throws InputError (JSON that is not such a record, a missing or damaged picture).
[[nodiscard]] ReportVideo read_video(const std::filesystem::path& record);

}  // namespace tt3d
