#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "tt3d/config.h"
#include "tt3d/core.h"
#include "tt3d/record.h"
#include "tt3d/report.h"
#include "tt3d/scene.h"

/// A run: the stages that turn a configuration into the files of a run folder.
namespace tt3d::run {

class Run;

/// A stage of a run. Each writes only into its own folder.
struct Stage {
  std::string name;
  std::filesystem::path folder;   ///< folder inside the run folder; empty: the stage writes its
                                  ///< product alone
  std::filesystem::path product;  ///< file that later stages read; without it the stage is not done
  std::function<void(Run&, Progress&)> run;
};
/// The stages, in order.
[[nodiscard]] const std::vector<Stage>& stages();

/// A run folder. A lock keeps other processes from using it at the same time.
class Run {
 public:
  /// Opens or creates the folder for `config`. Throws InputError with the differing keys if the
  /// folder was made with another configuration, unless `restart` is true: then the folder is
  /// emptied.
  Run(const std::filesystem::path& folder, const RunConfig& config, bool restart);
  /// Opens an existing folder with its own configuration.
  static Run open(const std::filesystem::path& folder);

  [[nodiscard]] const RunConfig& config() const { return config_; }
  [[nodiscard]] const std::filesystem::path& folder() const { return folder_; }
  /// The finished stages.
  [[nodiscard]] const std::vector<record::StageRecord>& finished() const { return finished_; }
  /// Sets the device of the stages; the default is the CPU. It is not part of the configuration, so
  /// a run can resume on another device.
  void use_device(at::Device device) { device_ = device; }
  /// Sets keys. If a value changes, forgets `first_stage` and all stages after it. A new seed holds
  /// from this stage on; each stage's record has the seed it used.
  void reconfigure(const std::vector<Assignment>& assignments, const std::string& first_stage);
  /// Marks a stage as not done; its product stays until the stage has run again.
  void forget(const std::string& stage);
  /// Marks a stage and all later ones as not done and removes their checkpoints.
  void forget_from(const std::string& stage);

  /// Runs all stages up to and including `last` that are not done. Throws the errors of the stages;
  /// InputError if a file has changed since a finished or interrupted stage read it.
  void run_until(const std::string& last, Progress& progress);
  /// Writes asset/clean.glb and .obj of the reconstructed object, before any attack. Runs the
  /// stages up to the mesh if needed.
  void bake_clean(Progress& progress);
  /// True if the stage has finished and its product still exists.
  [[nodiscard]] bool done(const Stage& stage) const;

  // ---- Stages: see stages() ----
  void run_field(Progress& progress);
  void run_mesh(Progress& progress);
  void run_attack(Progress& progress);
  void run_bake(Progress& progress);
  void run_evaluate(Progress& progress);
  void run_report(Progress& progress);

 private:
  Run() = default;
  void lock();
  void save() const;
  [[nodiscard]] record::RunRecord record() const;
  void enter(const record::StageRecord& finished);
  void run_stage(const Stage& stage, Progress& progress);
  /// Throws InputError if a file that a finished stage has read is different now.
  void check_inputs() const;
  /// Records files that the present stage reads, with their SHA-256, by absolute path. Throws
  /// InputError if the stage was interrupted and a file has changed since.
  void add_inputs(const std::vector<std::filesystem::path>& files);
  /// SHA-256 of a file; computed once.
  [[nodiscard]] const std::string& hash_of(const std::string& file) const;
  [[nodiscard]] bool from_asset() const { return !config_.asset.path.empty(); }

  const capture::Capture& photographs(Progress& progress);
  [[nodiscard]] scene::Placement placement(Progress& progress);
  [[nodiscard]] object::Object clean_object() const;
  void import_asset(Progress& progress);
  void save_mesh_stage(const object::Object& object, const scene::Normalization& normalization,
                       std::optional<double> psnr);
  /// The input of an attack without the models.
  [[nodiscard]] attack::AttackInput attack_input(Progress& progress);
  void load_surrogates(attack::AttackInput& input, Progress& progress);
  /// Opens the runs of the other objects of a universal attack and adds their inputs to `input`.
  [[nodiscard]] std::vector<Run> other_runs(attack::AttackInput& input, Progress& progress);
  void save_attack_files(const attack::AttackResult& result) const;
  /// Stores the result of a universal attack of another run.
  void adopt_attack(const Run& from, const attack::AttackResult& result);
  /// The UV map of the clean mesh, cached in the folder of the stage that needs it.
  [[nodiscard]] scene::UvMap uv_map(const scene::TriMesh& mesh,
                                    const std::filesystem::path& stage_folder) const;
  void write_asset(const std::string& name, const scene::TriMesh& mesh,
                   const object::Appearance& appearance, const scene::UvMap& map,
                   const scene::TriMesh& rest, const scene::Normalization& normalization);

  std::filesystem::path folder_;
  RunConfig config_;
  at::Device device_ = at::kCPU;
  std::vector<record::StageRecord> finished_;
  mutable std::map<std::string, std::string> hashes_;  ///< by file, as hash_of computed them
  std::optional<record::StageRecord> unfinished_;  ///< the present stage, or the interrupted one
  std::shared_ptr<capture::Capture> photographs_;
  asset::AssetFiles assets_;
  std::shared_ptr<void> lock_;  ///< released with the last copy of the run
};

/// Loads the pictures of the record of a video, if their folder exists. Throws InputError for a
/// missing or damaged picture.
[[nodiscard]] report::ShownVideo load_video(const std::filesystem::path& json_path,
                                            const record::VideoRecord& record);

}  // namespace tt3d::run
