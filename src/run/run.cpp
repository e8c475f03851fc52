#include "tt3d/run.h"

#include <ATen/Context.h>
#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <torch/headeronly/version.h>
#include <algorithm>

#include "run_files.h"
#include "tt3d/gpu_options.h"
#include "tt3d/json.h"
#include "tt3d/memory.h"
#include "tt3d/version.h"

namespace tt3d::run {
namespace fs = std::filesystem;
using record::StageRecord;

namespace {

constexpr const char* kRunFile = "run.json";

using ConfigValues = std::map<std::string, nlohmann::json>;

/// Lists keys with different values, as "key (old -> new)". A key that an older version did not
/// have counts as its default.
std::string differing_keys(const ConfigValues& before, const ConfigValues& now) {
  const ConfigValues defaults = config_json(RunConfig());
  std::string out;
  for (const auto& [name, value] : now) {
    const auto old = before.find(name);
    if (value == (old == before.end() ? defaults.at(name) : old->second)) continue;
    out += (out.empty() ? "" : ", ") + name + " (" +
           (old == before.end() ? "absent" : old->second.dump()) + " -> " + value.dump() + ")";
  }
  return out;
}

std::string described(at::Device device) {
  std::string text = device.str();
  if (gpu_options().half_mlp) text += ", half-precision MLPs";
  if (gpu_options().graphs) text += ", CUDA graphs";
  return text;
}

InputError changed_input(const std::string& file, const std::string& stage) {
  return {file, "has changed since stage '" + stage +
                    "' read it; restore the file, choose another run folder, or start over with "
                    "--restart"};
}

std::vector<Stage>::const_iterator find_stage(const std::string& name) {
  return std::find_if(stages().begin(), stages().end(),
                      [&](const Stage& s) { return s.name == name; });
}

}  // namespace

const std::vector<Stage>& stages() {
  static const std::vector<Stage> list = {
      {"field", "field", "field/field.safetensors", &Run::run_field},
      {"mesh", "mesh", "mesh/mesh.safetensors", &Run::run_mesh},
      {"attack", "attack", "attack/attack.safetensors", &Run::run_attack},
      {"bake", "asset", "asset/adversarial.glb", &Run::run_bake},
      {"evaluate", "eval", "eval/builtin.json", &Run::run_evaluate},
      {"report", "", "report.html", &Run::run_report}};
  return list;
}

Run::Run(const fs::path& folder, const RunConfig& config, bool restart)
    : folder_(fs::absolute(folder)), config_(config) {
  make_folder(folder_);
  lock();
  const fs::path file = folder_ / kRunFile;
  if (restart && fs::exists(file)) {
    for (const Stage& stage : stages()) {
      fs::remove_all(folder_ / (stage.folder.empty() ? stage.product : stage.folder));
    }
    fs::remove(file);
  }
  if (!fs::exists(file)) {
    save();
    return;
  }
  const auto recorded = read_json_as<record::RunRecord>(file);
  const std::string different = differing_keys(recorded.config, config_json(config_));
  if (!different.empty()) {
    throw InputError(folder_, "was made with another configuration: " + different +
                                  "; choose another --out, or use --restart to start over");
  }
  finished_ = recorded.stages;
  unfinished_ = recorded.unfinished;
}

Run Run::open(const fs::path& folder) {
  const fs::path file = fs::absolute(folder) / kRunFile;
  if (!fs::exists(file)) {
    throw InputError(folder,
                     "is not a run folder (no run.json); create one with 'tt3d fit' or 'tt3d run'");
  }
  Run run;
  run.folder_ = fs::absolute(folder);
  run.lock();
  const auto recorded = read_json_as<record::RunRecord>(file);
  run.config_ = config_from_json(recorded.config, file);
  run.config_.given = recorded.given;
  run.finished_ = recorded.stages;
  run.unfinished_ = recorded.unfinished;
  return run;
}

void Run::lock() {
  const int fd = ::open((folder_ / ".lock").c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (fd < 0) {
    throw ResourceError(folder_.string() + ": cannot write here; choose a writable folder");
  }
  lock_ = std::shared_ptr<void>(nullptr, [fd](void*) { ::close(fd); });
  if (::flock(fd, LOCK_EX | LOCK_NB) != 0) {
    throw InputError(folder_,
                     "is in use by another tt3d process; wait for it or choose another --out");
  }
}

record::RunRecord Run::record() const {
  record::RunRecord record;
  record.config = config_json(config_);
  record.given = config_.given;
  record.seed = config_.seed;
  record.versions = {{"tt3d", kVersion}, {"torch", TORCH_VERSION}};
  record.threads = at::get_num_threads();
  record.device = described(device_);
  for (const StageRecord& s : finished_) record.inputs.insert(s.inputs.begin(), s.inputs.end());
  record.stages = finished_;
  record.unfinished = unfinished_;
  return record;
}

void Run::save() const { write_json(folder_ / kRunFile, to_json(record())); }

bool Run::done(const Stage& stage) const {
  const bool recorded = std::any_of(finished_.begin(), finished_.end(),
                                    [&](const StageRecord& s) { return s.name == stage.name; });
  return recorded && fs::exists(folder_ / stage.product);
}

/// Adds a finished stage, or replaces an earlier one with the same name.
void Run::enter(const StageRecord& finished) {
  const auto same = std::find_if(finished_.begin(), finished_.end(),
                                 [&](const StageRecord& s) { return s.name == finished.name; });
  if (same == finished_.end())
    finished_.push_back(finished);
  else
    *same = finished;
}

void Run::reconfigure(const std::vector<Assignment>& assignments, const std::string& first_stage) {
  const ConfigValues before = config_json(config_);
  set_all(config_, assignments);
  if (config_json(config_) == before) return;  // an interrupted stage can resume
  forget_from(first_stage);
}

void Run::forget_from(const std::string& first) {
  for (auto stage = find_stage(first); stage != stages().end(); ++stage) {
    forget(stage->name);
    fs::remove(folder_ / stage->folder / kCheckpoint);
    if (unfinished_ && unfinished_->name == stage->name) unfinished_.reset();
  }
  save();
}

void Run::forget(const std::string& stage) {
  std::erase_if(finished_, [&](const StageRecord& s) { return s.name == stage; });
}

void Run::run_until(const std::string& last, Progress& progress) {
  check_inputs();
  for (const Stage& stage : stages()) {
    const bool needless = stage.name == "field" && from_asset();
    if (!done(stage) && !needless) run_stage(stage, progress);
    if (stage.name == last) return;
  }
}

void Run::run_stage(const Stage& stage, Progress& progress) {
  progress.check();
  // Only a checkpoint makes the files of an earlier try matter.
  const bool resumes = unfinished_ && unfinished_->name == stage.name &&
                       fs::exists(folder_ / stage.folder / kCheckpoint);
  if (!resumes) unfinished_ = StageRecord{stage.name, 0, 0, config_.seed, {}};
  const double start = now_seconds();
  reset_peak_memory();
  stage.run(*this, progress);
  unfinished_->seconds = now_seconds() - start;
  unfinished_->peak_rss_bytes = peak_memory_bytes();
  enter(*unfinished_);
  unfinished_.reset();
  save();
  fs::remove(folder_ / stage.folder / kCheckpoint);
}

void Run::check_inputs() const {
  for (const Stage& stage : stages()) {
    const auto record = std::find_if(finished_.begin(), finished_.end(),
                                     [&](const StageRecord& s) { return s.name == stage.name; });
    if (record == finished_.end() || !done(stage)) continue;
    for (const auto& [file, hash] : record->inputs) {
      if (!fs::exists(file)) continue;  // the stage is done and needs it no more
      if (hash_of(file) != hash) throw changed_input(file, stage.name);
    }
  }
}

void Run::add_inputs(const std::vector<fs::path>& files) {
  if (!unfinished_) return;  // another run lends its mesh to a universal attack
  for (const fs::path& path : files) {
    const std::string file = fs::absolute(path).string();
    const auto [entry, is_new] = unfinished_->inputs.emplace(file, hash_of(file));
    if (!is_new && entry->second != hash_of(file)) throw changed_input(file, unfinished_->name);
  }
  save();
}

const std::string& Run::hash_of(const std::string& file) const {
  const auto [entry, is_new] = hashes_.try_emplace(file);
  if (is_new) entry->second = sha256_file(file);
  return entry->second;
}

const capture::Capture& Run::photographs(Progress& progress) {
  if (!photographs_) {
    if (config_.capture.path.empty())
      throw InputError("capture.path: expected a folder of photographs");
    photographs_ =
        std::make_shared<capture::Capture>(capture::load_capture(config_.capture, progress));
  }
  add_inputs({photographs_->files.begin(), photographs_->files.end()});
  return *photographs_;
}

}  // namespace tt3d::run
