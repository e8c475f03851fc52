#include "tt3d/run.h"

#include <ATen/Context.h>
#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <map>
#include <nlohmann/json.hpp>

#include "tt3d/gpu_options.h"
#include "tt3d/version.h"

namespace tt3d {
namespace fs = std::filesystem;
using nlohmann::json;

namespace {

constexpr const char* kRunFile = "run.json";

/// The configuration as a flat object, key -> TOML value: what two runs are compared by.
json config_json(const RunConfig& config) {
  json j = json::object();
  for (const ConfigKey& key : config_keys(config)) j[key.name] = key.value;
  return j;
}

/// Keys whose values differ, as "key (old -> new)".
std::string differing_keys(const json& before, const json& now) {
  std::string out;
  for (const auto& [name, value] : now.items()) {
    const std::string old = before.contains(name) ? before[name].get<std::string>() : "absent";
    if (old != value.get<std::string>()) {
      out +=
          (out.empty() ? "" : ", ") + name + " (" + old + " -> " + value.get<std::string>() + ")";
    }
  }
  return out;
}

json read_run_file(const fs::path& path) {
  try {
    json j = json::parse(read_file(path));
    // What is read of it later, so that a wrong type is told here, with the file's name.
    (void)j.value("config", std::map<std::string, std::string>{});
    (void)j.value("inputs", std::map<std::string, std::string>{});
    (void)j.value("given", std::set<std::string>{});
    for (const json& stage : j.value("stages", json::array())) {
      (void)stage.at("name").get<std::string>();
      (void)stage.at("seconds").get<double>();
      (void)stage.at("peak_rss_bytes").get<int64_t>();
    }
    return j;
  } catch (const json::exception& error) {
    throw InputError(path, std::string("is not a run's record: ") + error.what());
  }
}

std::string described(at::Device device) {
  std::string text = device.str();
  if (gpu_options().half_mlp) text += ", half-precision MLPs";
  if (gpu_options().graphs) text += ", CUDA graphs";
  return text;
}

/// What later stages read of a stage: it is done where this is there.
fs::path product_of(const std::string& stage) {
  static const std::map<std::string, fs::path> products = {
      {"field", "field/field.safetensors"},    {"mesh", "mesh/mesh.safetensors"},
      {"attack", "attack/attack.safetensors"}, {"bake", "asset/adversarial.glb"},
      {"evaluate", "eval/builtin.json"},       {"report", "report.html"}};
  return products.at(stage);
}

}  // namespace

const std::vector<std::string>& Run::stage_names() {
  static const std::vector<std::string> names = {"field", "mesh",     "attack",
                                                 "bake",  "evaluate", "report"};
  return names;
}

Run::Run(const fs::path& folder, const RunConfig& config, bool restart)
    : folder_(fs::absolute(folder)), config_(config) {
  make_folder(folder_);
  lock();
  const fs::path record = folder_ / kRunFile;
  if (restart && fs::exists(record)) {
    for (const char* part : {"field", "mesh", "attack", "asset", "eval", "report.html", kRunFile}) {
      fs::remove_all(folder_ / part);
    }
  }
  if (!fs::exists(record)) {
    save();
    return;
  }
  const std::string different =
      differing_keys(read_run_file(record).value("config", json::object()), config_json(config_));
  if (!different.empty()) {
    throw InputError(folder_, "was made with another configuration: " + different +
                                  "; choose another --out, or --restart to start over");
  }
  load_stages();
}

Run Run::open(const fs::path& folder) {
  const fs::path record = fs::absolute(folder) / kRunFile;
  if (!fs::exists(record)) {
    throw InputError(folder,
                     "is not a run folder (no run.json); 'tt3d fit' or 'tt3d run' makes one");
  }
  Run run;
  run.folder_ = fs::absolute(folder);
  run.lock();
  const json recorded = read_run_file(record);
  std::vector<std::string> assignments;
  const json config = recorded.value("config", json::object());
  for (const auto& [name, value] : config.items()) {
    assignments.push_back(name + "=" + value.get<std::string>());
  }
  set_all(run.config_, assignments);
  run.config_.given = recorded.value("given", std::set<std::string>{});
  run.load_stages();
  return run;
}

void Run::lock() {
  const int fd = ::open((folder_ / ".lock").c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (fd < 0) {
    throw ResourceError(folder_.string() +
                        ": cannot write here; choose a folder that can be written");
  }
  lock_ = std::shared_ptr<void>(nullptr, [fd](void*) { ::close(fd); });
  if (::flock(fd, LOCK_EX | LOCK_NB) != 0) {
    throw InputError(folder_, "is in use by another tt3d; wait for it or choose another --out");
  }
}

void Run::save() const {
  json stages = json::array();
  for (const StageRecord& s : stages_) {
    stages.push_back(
        {{"name", s.name}, {"seconds", s.seconds}, {"peak_rss_bytes", s.peak_rss_bytes}});
  }
  const json j = {{"config", config_json(config_)},
                  {"given", config_.given},
                  {"seed", config_.seed},
                  {"versions", {{"tt3d", kVersion}, {"torch", "2.11.0"}}},
                  {"threads", at::get_num_threads()},
                  {"device", described(device_)},
                  {"inputs", input_hashes_},
                  {"stages", stages}};
  write_file_atomic(folder_ / kRunFile, j.dump(1) + "\n");
}

void Run::load_stages() {
  const json j = read_run_file(folder_ / kRunFile);
  stages_.clear();
  for (const json& s : j.value("stages", json::array())) {
    stages_.push_back({s.at("name").get<std::string>(), s.at("seconds").get<double>(),
                       s.at("peak_rss_bytes").get<int64_t>()});
  }
  input_hashes_ = j.value("inputs", std::map<std::string, std::string>{});
}

bool Run::done(const std::string& stage) const {
  const bool recorded = std::any_of(stages_.begin(), stages_.end(),
                                    [&](const StageRecord& s) { return s.name == stage; });
  return recorded && fs::exists(folder_ / product_of(stage));
}

void Run::record(const StageRecord& finished) {
  for (StageRecord& s : stages_) {
    if (s.name == finished.name) {
      s = finished;  // its product was gone
      return;
    }
  }
  stages_.push_back(finished);
}

void Run::reconfigure(const std::vector<std::string>& assignments, const std::string& first_stage) {
  const json before = config_json(config_);
  set_all(config_, assignments);
  if (config_json(config_) == before) return;  // an interrupted stage goes on
  const auto& names = stage_names();
  const auto first = std::find(names.begin(), names.end(), first_stage);
  for (auto stage = first; stage != names.end(); ++stage) {
    std::erase_if(stages_, [&](const StageRecord& s) { return s.name == *stage; });
    fs::remove(folder_ / *stage / "checkpoint.safetensors");
  }
  save();
}

void Run::forget(const std::string& stage) {
  std::erase_if(stages_, [&](const StageRecord& s) { return s.name == stage; });
}

void Run::run_until(const std::string& last, Progress& progress) {
  for (const std::string& name : stage_names()) {
    const bool needless = name == "field" && !config_.asset.empty();
    if (!done(name) && !needless) {
      progress.check();
      const double start = now_seconds();
      reset_peak_memory();
      run_stage(name, progress);
      record({name, now_seconds() - start, peak_memory_bytes()});
      save();
    }
    if (name == last) return;
  }
}

void Run::run_stage(const std::string& name, Progress& progress) {
  if (name == "field")
    run_field(progress);
  else if (name == "mesh" && config_.asset.empty())
    run_mesh(progress);
  else if (name == "mesh")
    take_asset(progress);
  else if (name == "attack")
    run_attack_stage(progress);
  else if (name == "bake")
    run_bake(progress);
  else if (name == "evaluate")
    run_evaluate(progress);
  else
    run_report(progress);
}

void Run::adopt_attack(const Run& from, const AttackResult& result) {
  std::vector<std::string> assignments;
  for (const ConfigKey& key : config_keys(from.config_)) {
    const bool of_attack = key.name.starts_with("attack.") && key.name != "attack.also";
    if (of_attack) assignments.push_back(key.name + "=" + key.value);
  }
  reconfigure(assignments, "attack");
  save_attack_files(result);
  record({"attack", 0, 0});
  save();
}

const Capture& Run::capture(Progress& progress) {
  if (!capture_) {
    if (config_.capture.path.empty())
      throw InputError("capture.path: expected a folder of photographs");
    capture_ = std::make_shared<Capture>(load_capture(config_.capture, progress));
    for (const std::string& file : capture_->files) input_hashes_[file] = sha256_file(file);
  }
  return *capture_;
}

}  // namespace tt3d
