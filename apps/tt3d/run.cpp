#include <fmt/format.h>

#include <iostream>
#include <nlohmann/json.hpp>

#include "commands.h"
#include "tt3d/report.h"
#include "tt3d/run.h"

namespace tt3d::cli {
namespace fs = std::filesystem;
using nlohmann::json;
namespace {

/// What the commands of this file were given.
struct Arguments {
  std::string config, capture, run, asset, out, target, true_class, method, sticker_area,
      sticker_mask;
  std::vector<std::string> sets, surrogates, also, runs;
  bool restart = false;
};

void print_summary(const Run& run, const Common& common) {
  const std::string record = read_file(run.folder() / "eval" / "builtin.json");
  if (common.json) {
    std::cout << record;
    return;
  }
  const json mesh = json::parse(read_file(run.folder() / "mesh" / "metrics.json"));
  print_record(record);
  if (run.config().asset.empty()) {
    const json field = json::parse(read_file(run.folder() / "field" / "metrics.json"));
    std::cout << fmt::format("field PSNR {:.2f} dB, baked mesh PSNR {:.2f} dB, ",
                             field["psnr_test"].get<double>(),
                             mesh["psnr_test_baked"].get<double>());
  }
  std::cout << fmt::format("{} faces, {}\n", mesh["faces"].get<int64_t>(),
                           mesh["closed"].get<bool>() ? "closed and manifold" : "not closed");
  double seconds = 0;
  int64_t peak = 0;
  for (const StageRecord& s : run.stages()) {
    seconds += s.seconds;
    peak = std::max(peak, s.peak_rss_bytes);
  }
  std::cout << fmt::format("{:.0f} s, peak memory {:.2f} GiB\nreport: {}\n", seconds,
                           static_cast<double>(peak) / (1 << 30),
                           (run.folder() / "report.html").string());
}

/// A seed given on the command line rules over the configuration's.
void apply_seed(RunConfig& config, const Common& common, const CLI::App& command) {
  if (command.count("--seed") > 0) config.seed = common.seed;
}

void run_all(const Arguments& a, const Common& common, const CLI::App& command) {
  const at::Device device = apply_common(common);
  RunConfig config = load_config(a.config);
  set_all(config, a.sets);
  apply_seed(config, common, command);
  const fs::path out =
      a.run.empty() ? fs::path("runs") / fs::path(a.config).stem() : fs::path(a.run);
  const auto progress = make_progress(common);
  Run run(out, config, a.restart);
  run.use_device(device);
  run.run_until("report", *progress);
  print_summary(run, common);
}

void fit(const Arguments& a, const Common& common, const CLI::App& command) {
  const at::Device device = apply_common(common);
  RunConfig config;
  config.capture.path = fs::absolute(a.capture);
  set_all(config, a.sets);
  apply_seed(config, common, command);
  const auto progress = make_progress(common);
  Run run(a.run, config, a.restart);
  run.use_device(device);
  run.run_until("field", *progress);
  std::cout << read_file(run.folder() / "field" / "metrics.json");
}

/// Runs a stage of an existing run, with keys changed first.
Run continue_run(const Arguments& a, const Common& common, std::vector<std::string> assignments,
                 const std::string& stage) {
  const at::Device device = apply_common(common);
  Run run = Run::open(a.run);
  run.use_device(device);
  assignments.insert(assignments.end(), a.sets.begin(), a.sets.end());
  if (!assignments.empty()) run.reconfigure(assignments, stage);
  // A page takes seconds, and what eval/ holds may have grown since.
  if (stage == "report") run.forget(stage);
  const auto progress = make_progress(common);
  run.run_until(stage, *progress);
  return run;
}

/// One run: its page. Several: the page that compares them.
void report_runs(Arguments& a, const Common& common) {
  if (a.runs.size() == 1 && a.out.empty()) {
    a.run = a.runs.front();
    std::cout << (continue_run(a, common, {}, "report").folder() / "report.html").string() << "\n";
    return;
  }
  if (a.out.empty()) throw InputError("report of several runs: name a folder with --out");
  std::vector<ComparedRun> compared;
  for (const std::string& text : a.runs) {
    const fs::path folder = text;
    if (!fs::is_directory(folder / "eval")) {
      throw InputError(folder, "expected a run folder with evaluations in eval/");
    }
    const RecordTexts records = records_in(folder / "eval");
    ComparedRun run{folder.filename().empty() ? folder.parent_path().filename().string()
                                              : folder.filename().string(),
                    records.evaluations,
                    fs::exists(folder / "run.json") ? read_file(folder / "run.json") : "",
                    records.judges,
                    {}};
    for (const fs::path& video : records.videos) run.video_records.push_back(read_file(video));
    compared.push_back(std::move(run));
  }
  const Comparison page = compare_runs(compared);
  const fs::path out = a.out;
  for (const ComparedTable& table : page.tables) {
    write_file_atomic(out / (table.file + ".csv"), table.csv);
    write_file_atomic(out / (table.file + ".tex"), table.latex);
  }
  write_file_atomic(out / "comparison.json", page.json);
  write_file_atomic(out / "comparison.html", page.html);
  std::cout << (out / "comparison.html").string() << "\n";
}

std::string toml_list(const std::vector<std::string>& words) {
  return json(words).dump();  // a JSON list of strings is a TOML one
}

/// Begins the run of an asset, unless the folder holds it already.
void begin_with_asset(Arguments& a, const Common& common, const CLI::App& command) {
  if (a.run.empty()) a.run = fs::path("runs") / fs::path(a.asset).stem();
  if (fs::exists(fs::path(a.run) / "run.json")) {
    if (Run::open(a.run).config().asset == fs::absolute(a.asset)) return;
    throw InputError(a.run, "holds the run of another object; choose another folder");
  }
  RunConfig config;
  config.asset = fs::absolute(a.asset);
  apply_seed(config, common, command);
  const Run run(a.run, config, false);
}

void attack(Arguments a, const Common& common, const CLI::App& command) {
  if (!a.asset.empty()) begin_with_asset(a, common, command);
  if (a.run.empty()) throw InputError("attack: expected a run folder, or --asset FILE");
  std::vector<std::string> assignments = {"attack.surrogates=" + toml_list(a.surrogates)};
  const auto assign = [&](const std::string& key, const std::string& word) {
    if (!word.empty()) assignments.push_back(key + "=" + json(word).dump());
  };
  assign("attack.target", a.target);
  assign("evaluate.true_class", a.true_class);
  assign("attack.method", a.method);
  if (!a.sticker_area.empty()) assignments.push_back("attack.sticker_area=" + a.sticker_area);
  if (!a.sticker_mask.empty()) assign("attack.sticker_mask", fs::absolute(a.sticker_mask));
  // Not kept from an attack before: another method may not wear it.
  std::vector<std::string> folders;
  for (const std::string& run : a.also) folders.push_back(fs::absolute(run));
  assignments.push_back("attack.also=" + toml_list(folders));
  const Run run = continue_run(a, common, assignments, "attack");
  std::cout << (run.folder() / "attack" / "attack.safetensors").string() << "\n";
}

void print_presets(const Common& common) {
  json list = json::array();
  for (const AttackPreset& p : attack_presets()) {
    list.push_back({{"method", p.name}, {"optimises", p.description}, {"source", p.source}});
    if (common.json) continue;
    std::cout << fmt::format("{:<18} {}\n{:<18}   {}\n", p.name, p.description, "", p.source);
  }
  if (common.json) std::cout << list.dump(1) << "\n";
}

CLI::App* stage_command(CLI::App& app, Common& common, Arguments& a, const std::string& name,
                        const std::string& description) {
  CLI::App* command = app.add_subcommand(name, description);
  command->add_option("RUN", a.run, "run folder")->required();
  command->add_option("--set", a.sets, "key=value of the configuration");
  add_common_options(*command, common);
  add_gpu_options(*command, common);
  return command;
}

}  // namespace

void add_run_commands(CLI::App& app, Common& common) {
  auto a = std::make_shared<Arguments>();
  CLI::App* all = app.add_subcommand("run", "all stages of a configuration; run again to resume");
  all->add_option("CONFIG", a->config, "configuration, TOML")->required();
  all->add_option("--out", a->run, "run folder; default runs/NAME");
  all->add_option("--set", a->sets, "key=value, over the file's");
  all->add_flag("--restart", a->restart, "start over in a folder that holds a run");
  add_common_options(*all, common);
  add_gpu_options(*all, common);
  all->callback([a, &common, all] { run_all(*a, common, *all); });

  CLI::App* field = app.add_subcommand("fit", "photographs to a radiance field");
  field->add_option("CAPTURE", a->capture, "folder of photographs and cameras")->required();
  field->add_option("--out", a->run, "run folder")->required();
  field->add_option("--set", a->sets, "key=value of the configuration");
  field->add_flag("--restart", a->restart, "start over in a folder that holds a run");
  add_common_options(*field, common);
  add_gpu_options(*field, common);
  field->callback([a, &common, field] { fit(*a, common, *field); });

  stage_command(app, common, *a, "mesh", "radiance field to a refined mesh")
      ->callback([a, &common] {
        std::cout << read_file(continue_run(*a, common, {}, "mesh").folder() / "mesh" /
                               "metrics.json");
      });
  CLI::App* command = stage_command(app, common, *a, "attack", "mesh to an adversarial mesh");
  command->get_option("RUN")->required(false);
  command->add_option("--asset", a->asset,
                      "textured mesh (GLB, OBJ) in place of a capture; RUN is then made");
  command->add_option("--also", a->also, "further runs whose objects shall wear the same tile");
  command->add_option("--target", a->target, "class: index, WordNet id or name");
  command->add_option("--true-class", a->true_class, "class of the object, for untargeted attacks");
  command->add_option("--surrogate", a->surrogates, "models the attack may see")->required();
  command->add_option("--method", a->method, "preset; --list describes them");
  command->add_option("--sticker-area", a->sticker_area,
                      "share of the surface where colours are free");
  command->add_option("--sticker-mask", a->sticker_mask,
                      "picture over asset/clean.png's charts, light where colours are free");
  command->add_flag_callback(
      "--list",
      [&common] {
        print_presets(common);
        throw CLI::Success();
      },
      "describe the methods and stop");
  command->callback([a, &common, command] { attack(*a, common, *command); });
  stage_command(app, common, *a, "bake", "textured files of the clean and the adversarial object")
      ->callback([a, &common] {
        std::cout << (continue_run(*a, common, {}, "bake").folder() / "asset").string() << "\n";
      });
  CLI::App* report =
      app.add_subcommand("report", "report.html of a run; with --out, many compared");
  report->add_option("RUN", a->runs, "run folders")->required();
  report->add_option("--out", a->out,
                     "folder for comparison.html, .json, and tables as .csv and .tex");
  report->add_option("--set", a->sets, "key=value of the configuration, of a single run");
  add_common_options(*report, common);
  report->callback([a, &common] { report_runs(*a, common); });
}

void print_record(const std::string& record_json) {
  const json r = json::parse(record_json);
  const auto percent = [](const json& x) {
    return x.is_null() ? std::string("-") : fmt::format("{:.1f} %", 100 * x.get<double>());
  };
  std::cout << fmt::format(
      "target {} ({}), {} views of '{}' on {}\n", r["target"]["name"].get<std::string>(),
      r["target"]["index"].get<int64_t>(), r["views"]["count"].get<int64_t>(),
      r["views"]["distribution"].get<std::string>(), r["background"].get<std::string>());
  std::cout << fmt::format("{:<24} {:>8} {:>18} {:>10} {:>14} {:>10}\n", "victim", "ASR",
                           "95 % interval", "clean acc", "ASR if correct", "p(target)");
  for (const json& v : r["victims"]) {
    const std::string interval =
        fmt::format("{:.1f} to {:.1f} %", 100 * v["asr_ci95"][0].get<double>(),
                    100 * v["asr_ci95"][1].get<double>());
    std::cout << fmt::format("{:<24} {:>8} {:>18} {:>10} {:>14} {:>10.3f}\n",
                             v["name"].get<std::string>(), percent(v["asr"]), interval,
                             percent(v["clean_accuracy"]), percent(v["asr_on_correct"]),
                             v["mean_target_probability"].get<double>());
  }
  const json& n = r["naturalness"];
  if (!n["psnr"].is_null()) {
    std::cout << fmt::format("against the clean object: PSNR {:.2f} dB, SSIM {:.3f}\n",
                             n["psnr"].get<double>(), n["ssim"].get<double>());
  }
}

}  // namespace tt3d::cli
