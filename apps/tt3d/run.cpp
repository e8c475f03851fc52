#include <fmt/format.h>

#include <iostream>
#include <nlohmann/json.hpp>

#include "commands.h"
#include "key_options.h"
#include "tt3d/json.h"
#include "tt3d/report.h"
#include "tt3d/run.h"

namespace tt3d::cli {
namespace fs = std::filesystem;
using nlohmann::json;
namespace {

/// RunArguments of the commands in this file.
struct RunArguments {
  std::string config, capture, run, asset, out;
  std::vector<std::string> sets, also, runs;
  std::vector<run::Assignment> assignments;  ///< options for configuration keys
  bool restart = false, clean = false;
};

void print_summary(const run::Run& run, const Common& common) {
  const fs::path& folder = run.folder();
  print_record(record::load_evaluation(folder / "eval" / "builtin.json"), common);
  if (common.json) return;
  const auto mesh = read_json_as<record::MeshMetrics>(folder / "mesh" / "metrics.json");
  if (run.config().asset.path.empty()) {
    const auto field = read_json_as<record::FieldMetrics>(folder / "field" / "metrics.json");
    const auto asset = read_json_as<record::AssetMetrics>(folder / "asset" / "metrics.json");
    std::cout << fmt::format("field PSNR {:.2f} dB, baked mesh PSNR {:.2f} dB, ", field.psnr_test,
                             asset.psnr_test);
  }
  std::cout << fmt::format("{} faces, {}\n", mesh.faces,
                           mesh.closed ? "closed and manifold" : "not closed");
  double seconds = 0;
  int64_t peak = 0;
  for (const record::StageRecord& s : run.finished()) {
    seconds += s.seconds;
    peak = std::max(peak, s.peak_rss_bytes);
  }
  std::cout << fmt::format("{:.0f} s, peak memory {:.2f} GiB\nreport: {}\n", seconds,
                           static_cast<double>(peak) / (1 << 30),
                           (folder / "report.html").string());
}

/// A seed on the command line replaces that of the configuration.
void apply_seed(run::RunConfig& config, const Common& common, const CLI::App& command) {
  if (command.count("--seed") > 0) config.seed = common.seed;
}

/// Removes the folder of a run that its input refused before any stage began, if this command made
/// it.
class FreshFolder {
 public:
  explicit FreshFolder(fs::path folder)
      : folder_(std::move(folder)), fresh_(!fs::exists(folder_)) {}
  void refused() const {
    if (!fresh_ || !fs::is_directory(folder_)) return;
    for (const auto& entry : fs::directory_iterator(folder_)) {
      const std::string name = entry.path().filename().string();
      if (name != "run.json" && name != ".lock") return;
    }
    std::error_code ignored;
    fs::remove_all(folder_, ignored);
  }

 private:
  fs::path folder_;
  bool fresh_;
};

/// Runs the stages of a new or resumed run folder.
void run_stages(run::Run& run, const std::string& last, const FreshFolder& folder,
                Progress& progress) {
  try {
    run.run_until(last, progress);
  } catch (const InputError&) {
    folder.refused();
    throw;
  }
}

void run_all(const RunArguments& a, const Common& common, const CLI::App& command) {
  const at::Device device = apply_common(common);
  run::RunConfig config = run::load_config(a.config);
  run::set_all(config, a.sets);
  apply_seed(config, common, command);
  const fs::path out =
      a.run.empty() ? fs::path("runs") / fs::path(a.config).stem() : fs::path(a.run);
  const auto progress = make_progress(common);
  const FreshFolder folder(out);
  run::Run run(out, config, a.restart);
  run.use_device(device);
  run_stages(run, "report", folder, *progress);
  print_summary(run, common);
}

void fit(const RunArguments& a, const Common& common, const CLI::App& command) {
  const at::Device device = apply_common(common);
  run::RunConfig config;
  config.capture.path = fs::absolute(a.capture);
  run::set_all(config, a.sets);
  apply_seed(config, common, command);
  const auto progress = make_progress(common);
  const FreshFolder folder(a.run);
  run::Run run(a.run, config, a.restart);
  run.use_device(device);
  run_stages(run, "field", folder, *progress);
  std::cout << read_file(run.folder() / "field" / "metrics.json");
}

/// Changes keys of an existing run and runs a stage.
run::Run continue_run(const RunArguments& a, const Common& common, const CLI::App& command,
                      const std::string& stage) {
  const at::Device device = apply_common(common);
  run::Run run = run::Run::open(a.run);
  run.use_device(device);
  std::vector<run::Assignment> assignments = a.assignments;
  for (const std::string& text : a.sets) assignments.push_back(run::parse_assignment(text));
  if (command.count("--seed") > 0) {
    assignments.push_back({"seed", static_cast<int64_t>(common.seed)});
  }
  if (a.restart) run.forget_from(stage);
  if (!assignments.empty()) run.reconfigure(assignments, stage);
  // Making the page takes seconds, and eval/ may have new records.
  if (stage == "report") run.forget(stage);
  const auto progress = make_progress(common);
  run.run_until(stage, *progress);
  return run;
}

report::ComparedRun compared_run(const fs::path& folder) {
  if (!fs::is_directory(folder / "eval")) {
    throw InputError(folder, "expected a run folder with evaluations in eval/");
  }
  report::ComparedRun run;
  run.name = folder.filename().empty() ? folder.parent_path().filename().string()
                                       : folder.filename().string();
  if (fs::exists(folder / "run.json")) {
    run.surrogates = read_json_as<record::RunRecord>(folder / "run.json").surrogates();
  }
  run.records = record::load_records(folder / "eval");
  return run;
}

/// Makes the page of one run, or the page that compares several runs.
void report_runs(RunArguments& a, const Common& common, const CLI::App& command) {
  if (command.count("--seed") > 0) {
    throw InputError("report: draws nothing at random; give --seed to mesh, attack or evaluate");
  }
  if (a.runs.size() == 1 && a.out.empty()) {
    a.run = a.runs.front();
    std::cout << (continue_run(a, common, command, "report").folder() / "report.html").string()
              << "\n";
    return;
  }
  if (a.out.empty()) throw InputError("report of several runs: give a folder with --out");
  std::vector<report::ComparedRun> compared;
  for (const std::string& folder : a.runs) compared.push_back(compared_run(folder));
  const report::Comparison page = report::compare_runs(compared);
  const fs::path out = a.out;
  for (const report::ComparedTable& table : page.tables) {
    write_file_atomic(out / (table.file + ".csv"), table.csv);
    write_file_atomic(out / (table.file + ".tex"), table.latex);
  }
  write_file_atomic(out / "comparison.json", page.json);
  write_file_atomic(out / "comparison.html", page.html);
  std::cout << (out / "comparison.html").string() << "\n";
}

/// Starts a run for an asset, unless the folder already has it.
void begin_with_asset(RunArguments& a, const Common& common, const CLI::App& command) {
  if (a.run.empty()) a.run = fs::path("runs") / fs::path(a.asset).stem();
  if (fs::exists(fs::path(a.run) / "run.json")) {
    if (run::Run::open(a.run).config().asset.path == fs::absolute(a.asset)) return;
    throw InputError(a.run, "is the run of another object; choose another folder");
  }
  run::RunConfig config;
  config.asset.path = fs::absolute(a.asset);
  apply_seed(config, common, command);
  const run::Run run(a.run, config, false);
}

void attack(RunArguments a, const Common& common, const CLI::App& command) {
  if (!a.asset.empty()) begin_with_asset(a, common, command);
  if (a.run.empty()) throw InputError("attack: expected a run folder, or --asset FILE");
  // Reset the value of an earlier attack: another method may not allow it.
  std::vector<std::string> folders;
  for (const std::string& run : a.also) folders.push_back(fs::absolute(run));
  a.assignments.push_back({"attack.also", folders});
  const run::Run run = continue_run(a, common, command, "attack");
  std::cout << (run.folder() / "attack" / "attack.safetensors").string() << "\n";
}

void print_presets(const Common& common) {
  json list = json::array();
  for (const attack::AttackPreset& p : attack::attack_presets()) {
    list.push_back({{"method", p.name}, {"optimises", p.description}, {"source", p.source}});
    if (common.json) continue;
    std::cout << fmt::format("{:<18} {}\n{:<18}   {}\n", p.name, p.description, "", p.source);
  }
  if (common.json) std::cout << list.dump(1) << "\n";
}

CLI::App* stage_command(CLI::App& app, Common& common, RunArguments& a, const std::string& name,
                        const std::string& description) {
  CLI::App* command = app.add_subcommand(name, description);
  command->add_option("RUN", a.run, "run folder")->required();
  command->add_option("--set", a.sets, "key=value of the configuration");
  command->add_flag("--restart", a.restart, "run this stage and the later ones again");
  add_common_options(*command, common);
  add_gpu_options(*command, common);
  return command;
}

void add_run(CLI::App& app, Common& common) {
  auto a = std::make_shared<RunArguments>();
  CLI::App* command =
      app.add_subcommand("run", "run all stages of a configuration; run again to resume");
  command->add_option("CONFIG", a->config, "configuration, TOML")->required();
  command->add_option("--out", a->run, "run folder; default runs/NAME");
  command->add_option("--set", a->sets, "key=value; replaces the value in the file");
  command->add_flag("--restart", a->restart, "start over in a folder with a run");
  add_common_options(*command, common);
  add_gpu_options(*command, common);
  command->callback([a, &common, command] { run_all(*a, common, *command); });
}

void add_fit(CLI::App& app, Common& common) {
  auto a = std::make_shared<RunArguments>();
  CLI::App* command = app.add_subcommand("fit", "fit a radiance field to photographs");
  command->add_option("CAPTURE", a->capture, "folder of photographs and cameras, or a camera file")
      ->required();
  command->add_option("--out", a->run, "run folder")->required();
  command->add_option("--set", a->sets, "key=value of the configuration");
  command->add_flag("--restart", a->restart, "start over in a folder with a run");
  add_common_options(*command, common);
  add_gpu_options(*command, common);
  command->callback([a, &common, command] { fit(*a, common, *command); });
}

void add_mesh(CLI::App& app, Common& common) {
  auto a = std::make_shared<RunArguments>();
  CLI::App* command =
      stage_command(app, common, *a, "mesh", "extract and refine a mesh from the radiance field");
  command->callback([a, &common, command] {
    const fs::path folder = continue_run(*a, common, *command, "mesh").folder();
    std::cout << read_file(folder / "mesh" / "metrics.json");
  });
}

void add_attack(CLI::App& app, Common& common) {
  auto a = std::make_shared<RunArguments>();
  CLI::App* command = stage_command(app, common, *a, "attack", "attack the mesh");
  command->get_option("RUN")->required(false);
  command->add_option("--asset", a->asset,
                      "textured mesh (GLB, glTF, OBJ) in place of a capture; creates RUN");
  command->add_option("--also", a->also, "run folders of further objects that share the same tile");
  const auto key = [&](const char* flag, const char* name) {
    return add_assignment(*command, flag, name, a->assignments);
  };
  key("--target", "attack.target");
  key("--true-class", "evaluate.true_class");
  key("--surrogate", "attack.surrogates")->required();
  key("--method", "attack.method");
  key("--sticker-area", "attack.sticker_area");
  key("--sticker-mask", "attack.sticker_mask");
  command->add_flag_callback(
      "--list",
      [&common] {
        print_presets(common);
        throw CLI::Success();
      },
      "list the methods and exit");
  command->callback([a, &common, command] { attack(*a, common, *command); });
}

void add_bake(CLI::App& app, Common& common) {
  auto a = std::make_shared<RunArguments>();
  CLI::App* command = stage_command(app, common, *a, "bake",
                                    "write textured files of the clean and the adversarial object");
  command->add_flag("--clean", a->clean, "only the reconstructed object, before any attack");
  command->callback([a, &common, command] {
    if (a->clean) {
      if (!a->sets.empty() || a->restart) {
        throw InputError("bake --clean: takes neither --set nor --restart");
      }
      std::cout << clean_asset(a->run, common).string() << "\n";
      return;
    }
    std::cout << (continue_run(*a, common, *command, "bake").folder() / "asset").string() << "\n";
  });
}

void add_report(CLI::App& app, Common& common) {
  auto a = std::make_shared<RunArguments>();
  CLI::App* command =
      app.add_subcommand("report", "write report.html of a run; with --out, compare runs");
  command->add_option("RUN", a->runs, "run folders")->required();
  command->add_option(
      "--out", a->out,
      "folder of comparison.html, comparison.json, and the tables as .csv and .tex");
  command->add_option("--set", a->sets, "key=value of the configuration; for a single run");
  add_common_options(*command, common);
  command->callback([a, &common, command] { report_runs(*a, common, *command); });
}

}  // namespace

void add_run_commands(CLI::App& app, Common& common) {
  add_run(app, common);
  add_fit(app, common);
  add_mesh(app, common);
  add_attack(app, common);
  add_bake(app, common);
  add_report(app, common);
}

fs::path clean_asset(const fs::path& folder, const Common& common) {
  const at::Device device = apply_common(common);
  run::Run run = run::Run::open(folder);
  run.use_device(device);
  const auto progress = make_progress(common);
  run.bake_clean(*progress);
  return run.folder() / "asset" / "clean.glb";
}

void print_record(const record::EvaluationRecord& r, const Common& common) {
  if (common.json) {
    std::cout << to_json(r).dump(1) << "\n";
    return;
  }
  const auto percent = [](const std::optional<double>& x) {
    return x ? fmt::format("{:.1f} %", 100 * *x) : std::string("-");
  };
  std::cout << fmt::format("target {} ({}), {} views of '{}' on {}\n", r.target.name,
                           r.target.index, r.views.count, r.views.distribution, r.background);
  std::cout << fmt::format("{:<24} {:>8} {:>18} {:>10} {:>14} {:>10}\n", "victim", "ASR",
                           "95 % interval", "clean acc", "ASR if correct", "p(target)");
  for (const record::VictimRecord& v : r.victims) {
    const std::string interval =
        fmt::format("{:.1f} to {:.1f} %", 100 * v.asr_ci95.low, 100 * v.asr_ci95.high);
    std::cout << fmt::format("{:<24} {:>8} {:>18} {:>10} {:>14} {:>10.3f}\n", v.name,
                             percent(v.asr), interval, percent(v.clean_accuracy),
                             percent(v.asr_on_correct), v.mean_target_probability);
  }
  if (r.naturalness.psnr && r.naturalness.ssim) {
    std::cout << fmt::format("against the clean object: PSNR {:.2f} dB, SSIM {:.3f}\n",
                             *r.naturalness.psnr, *r.naturalness.ssim);
  }
}

}  // namespace tt3d::cli
