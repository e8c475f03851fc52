#include <ATen/ATen.h>
#include <fmt/format.h>

#include <cmath>
#include <fstream>
#include <iostream>
#include <nlohmann/json.hpp>

#include "commands.h"
#include "key_options.h"
#include "tt3d/asset.h"
#include "tt3d/evaluate.h"
#include "tt3d/image.h"
#include "tt3d/input_files.h"
#include "tt3d/json.h"
#include "tt3d/report.h"
#include "tt3d/run.h"
#include "tt3d/scene.h"
#include "tt3d/tensor_file.h"
#include "tt3d/tool.h"

/// Commands that run the Python tools: export, print-check, print-sheet, judge; and video-score.
namespace tt3d::cli {
namespace fs = std::filesystem;
using nlohmann::json;
namespace {

constexpr double kToolSeconds = 1800;

/// The longest side of the bounding box.
double longest_side(const asset::TexturedMesh& mesh) {
  const at::Tensor span = std::get<0>(mesh.vertices.max(0)) - std::get<0>(mesh.vertices.min(0));
  return span.max().item<double>();
}

void write_asset(asset::TexturedMesh mesh, const fs::path& out, double size_mm,
                 Progress& progress) {
  const bool glb = has_extension(out, {".glb"});
  if (glb || has_extension(out, {".obj"})) {
    if (size_mm > 0) {
      const double scale = size_mm / longest_side(mesh);
      mesh.vertices = mesh.vertices * scale;
      for (double& coordinate : mesh.origin) coordinate *= scale;
    }
    glb ? asset::write_glb(mesh, out) : asset::write_obj(mesh, out);
    return;
  }
  if (!has_extension(out, {".3mf", ".stl", ".ply"})) {
    throw InputError(out, "expected .glb, .obj, .ply, .3mf or .stl");
  }
  if (!out.parent_path().empty()) make_folder(out.parent_path());
  if (mesh.origin != std::array{0.0, 0.0, 0.0}) {
    progress.note(
        fmt::format("{}: the coordinates are too large for float32; it is written relative "
                    "to the point ({}, {}, {})",
                    out.string(), mesh.origin[0], mesh.origin[1], mesh.origin[2]));
  }
  const ExchangeFolder folder;
  asset::save_mesh_tensors(mesh, folder / "mesh.safetensors");
  (void)run_tool("export_mesh.py",
                 {(folder / "mesh.safetensors").string(), fs::absolute(out).string(),
                  fmt::format("{}", size_mm)},
                 "export", kToolSeconds, progress);
}

// ---- export -------------------------------------------------------------------------------

struct ExportArguments {
  std::string asset, out;
  double size_mm = 0;
};

void add_export(CLI::App& app, Common& common) {
  auto a = std::make_shared<ExportArguments>();
  CLI::App* command = app.add_subcommand("export", "write an asset as GLB, OBJ, PLY, 3MF or STL");
  command->add_option("ASSET", a->asset, "GLB, glTF or OBJ")->required();
  command->add_option("--out", a->out, "FILE.glb, .obj, .ply, .3mf or .stl")->required();
  command->add_option("--size-mm", a->size_mm, "longest side, mm; default: the units of the asset")
      ->check(CLI::PositiveNumber);
  add_common_options(*command, common);
  command->callback([a, &common] {
    (void)apply_common(common);
    const auto progress = make_progress(common);
    write_asset(asset::load_asset(a->asset, progress.get()), a->out, a->size_mm, *progress);
    std::cout << a->out << "\n";
  });
}

// ---- print-check --------------------------------------------------------------------------

struct PrintArguments {
  std::string asset, gamut, repair;
  double size_mm = 100, wall_mm = 1, overhang_deg = 45, flat_base_mm = 0;
};

void print_findings(const json& result) {
  for (const json& line : result["repaired"]) {
    std::cout << "repaired: " << line.get<std::string>() << "\n";
  }
  for (const json& f : result["findings"]) {
    std::cout << fmt::format("{:<4} {:<20} {}\n", f["ok"].get<bool>() ? "ok" : "FAIL",
                             f["check"].get<std::string>(), f["text"].get<std::string>());
    const std::string advice = f["advice"];
    if (!advice.empty()) std::cout << fmt::format("     {:<20} {}\n", "", advice);
  }
}

void print_check(const PrintArguments& a, const Common& common) {
  (void)apply_common(common);
  if (a.flat_base_mm > 0 && a.repair.empty()) {
    throw InputError("--flat-base changes the mesh: give an output file with --repair");
  }
  const auto progress = make_progress(common);
  asset::TexturedMesh mesh = asset::load_asset(a.asset, progress.get());
  const ExchangeFolder folder;
  asset::save_mesh_tensors(mesh, folder / "mesh.safetensors");
  const json job = {{"mesh", (folder / "mesh.safetensors").string()},
                    {"size_mm", a.size_mm},
                    {"wall_mm", a.wall_mm},
                    {"overhang_deg", a.overhang_deg},
                    {"flat_base_mm", a.flat_base_mm},
                    {"gamut", a.gamut.empty() ? "" : fs::absolute(a.gamut).string()},
                    {"repair", a.repair.empty() ? "" : (folder / "mended.safetensors").string()},
                    {"out", (folder / "findings.json").string()}};
  write_file_atomic(folder / "job.json", job.dump());
  (void)run_tool("print_check.py", {(folder / "job.json").string()}, "print-check", kToolSeconds,
                 *progress);
  const json result = json::parse(read_file(folder / "findings.json"));
  if (!a.repair.empty()) {
    const TensorFile mended = load_tensors(folder / "mended.safetensors");
    mesh.vertices = mended.get("vertices", {-1, 3}, at::kFloat);
    mesh.faces = mended.get("faces", {-1, 3}, at::kInt);
    mesh.map.uvs = mended.get("uvs", {-1, 2}, at::kFloat);
    mesh.map.faces = mended.get("uv_faces", {-1, 3}, at::kInt);
    write_asset(mesh, a.repair, a.size_mm, *progress);
  }
  if (common.json)
    std::cout << result.dump(1) << "\n";
  else
    print_findings(result);
}

void add_print_check(CLI::App& app, Common& common) {
  auto a = std::make_shared<PrintArguments>();
  CLI::App* command =
      app.add_subcommand("print-check", "find faults that prevent 3D printing, with advice");
  command->add_option("ASSET", a->asset, "GLB, glTF or OBJ")->required();
  command->add_option("--size-mm", a->size_mm, "longest side of the print")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--wall-mm", a->wall_mm, "thinnest wall that the printer can make, mm")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command
      ->add_option("--overhang-deg", a->overhang_deg,
                   "largest overhang without supports, degrees from the vertical")
      ->check(CLI::Range(0, 90))
      ->capture_default_str();
  command->add_option("--gamut", a->gamut, "file of printable colours, one #rrggbb per line");
  command
      ->add_option("--flat-base", a->flat_base_mm,
                   "height at the bottom that --repair makes flat, mm")
      ->check(CLI::NonNegativeNumber);
  command->add_option("--repair", a->repair, "file of the repaired asset, scaled to --size-mm");
  add_common_options(*command, common);
  command->callback([a, &common] { print_check(*a, common); });
}

// ---- print-sheet --------------------------------------------------------------------------

struct SheetArguments {
  std::string out, object = "object", target;
  double size_mm = 100;
};

void add_print_sheet(CLI::App& app, Common& common) {
  auto a = std::make_shared<SheetArguments>();
  CLI::App* command = app.add_subcommand(
      "print-sheet", "write a page with a scale bar and a protocol for filming a print");
  command->add_option("--out", a->out, "FILE.svg")->required();
  command->add_option("--object", a->object, "name of the object on the page")
      ->capture_default_str();
  command->add_option("--target", a->target, "name of the target class");
  command->add_option("--size-mm", a->size_mm, "longest side of the print")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  add_common_options(*command, common);
  command->callback([a, &common] {
    const auto progress = make_progress(common);
    (void)run_tool(
        "print_sheet.py",
        {fs::absolute(a->out).string(), a->object, a->target, fmt::format("{}", a->size_mm)},
        "print-sheet", 60, *progress);
    std::cout << a->out << "\n";
  });
}

// ---- judge --------------------------------------------------------------------------------

struct JudgeArguments {
  std::string task, text, model, out;
  evaluate::EvaluateOptions options;  ///< uses asset, views, background and renderer
  KeyList keys, renderer_keys;        ///< bound to options
  double threshold = 0.5;             ///< as in the paper

  JudgeArguments() {
    options.views = 20;
    options.keys(keys);
    options.renderer.keys(renderer_keys);
  }
};

/// Splits "a hot dog. a teddy bear." into phrases.
std::vector<std::string> phrases_in(const std::string& text) {
  std::vector<std::string> phrases;
  std::string phrase;
  for (const char c : text + ".") {
    if (c != '.') {
      phrase += c;
      continue;
    }
    const size_t begin = phrase.find_first_not_of(' ');
    if (begin != std::string::npos) phrases.push_back(phrase.substr(begin));
    phrase.clear();
  }
  if (phrases.empty()) throw InputError("--text: expected phrases that end in dots");
  return phrases;
}

/// Writes pictures of an asset over its background as PNG files.
json write_pictures(const JudgeArguments& a, const Common& common, const ExchangeFolder& folder,
                    Progress& progress) {
  const evaluate::EvaluateOptions& o = a.options;
  const asset::TexturedMesh mesh = asset::load_asset(o.asset, &progress);
  const auto views = evaluate::evaluation_views(o.view_distribution, common.seed, o.views, o.size,
                                                asset::view_frame(mesh, o.asset));
  const evaluate::AssetViews pictures(o.asset, mesh, views, o.renderer, apply_common(common),
                                      progress);
  const scene::Backgrounds background(o.background);
  json files = json::array();
  for (int64_t i = 0; i < o.views; ++i) {
    const at::Tensor picture =
        evaluate::pictures_over(pictures, background, i, i + 1, common.seed)[0];
    const fs::path file = folder / fmt::format("judged{}.png", i);
    write_file_atomic(file, image::encode_png(image::to_uint8(picture.permute({1, 2, 0}).cpu())));
    files.push_back(file.string());
  }
  return files;
}

/// Runs the judge over the pictures.
record::JudgeRecord ask(const JudgeArguments& a, const std::vector<std::string>& phrases,
                        const Common& common, Progress& progress) {
  const ExchangeFolder folder;
  const json job = {
      {"task", a.task},
      {"model", fs::absolute(a.model.empty() ? "models/judges/" + a.task : a.model).string()},
      {"texts", phrases},
      {"threshold", a.threshold},
      {"pictures", write_pictures(a, common, folder, progress)},
      {"out", (folder / "answers.json").string()}};
  write_file_atomic(folder / "job.json", job.dump());
  (void)run_tool("judge.py", {(folder / "job.json").string()}, "judge", kToolSeconds, progress);
  const json document = read_json(folder / "answers.json");
  const JsonValue answers(document, folder / "answers.json");
  const evaluate::EvaluateOptions& o = a.options;
  record::JudgeRecord record;
  record.task = answers.at("task").as<std::string>();
  record.model = answers.at("model").as<std::string>();
  record.shares = answers.at("shares").as<std::map<std::string, double>>();
  record.answers = answers.at("answers").raw();
  record.asset = o.asset.string();
  record.renderer = {name_of(o.renderer.name), std::nullopt, o.renderer.lit, std::nullopt};
  record.background = o.background;
  record.views = {name_of(o.view_distribution), o.views, common.seed, o.size};
  return record;
}

void judge(const JudgeArguments& a, const Common& common) {
  const auto progress = make_progress(common);
  const auto phrases = phrases_in(a.text);
  const record::JudgeRecord record = ask(a, phrases, common, *progress);
  if (!a.out.empty()) write_json(a.out, to_json(record));
  if (common.json) {
    std::cout << to_json(record).dump(1) << "\n";
    return;
  }
  for (const std::string& phrase : phrases) {
    std::cout << fmt::format("{:<24} found in {:.1f} % of {} views\n", phrase,
                             100 * record.shares.at(phrase), record.views.count);
  }
}

void add_judge(CLI::App& app, Common& common) {
  CLI::App* group =
      app.add_subcommand("judge", "test models of other tasks: detection, captions, zero-shot");
  group->require_subcommand(1);
  for (const auto& [task, words] : {std::pair{"detect", "zero-shot detection with Grounding DINO"},
                                    {"caption", "captions with BLIP"},
                                    {"zeroshot", "zero-shot classification with CLIP"}}) {
    auto a = std::make_shared<JudgeArguments>();
    a->task = task;
    CLI::App* command = group->add_subcommand(task, words);
    command->add_option("ASSET", a->options.asset, "GLB, glTF or OBJ")->required();
    command
        ->add_option("--text", a->text, "phrases that end in dots: \"TRUE CLASS. TARGET CLASS.\"")
        ->required();
    command->add_option("--model", a->model, "folder of the model; default models/judges/TASK");
    add_key_option(*command, "--views", a->keys, "views");
    add_key_option(*command, "--view-distribution", a->keys, "view_distribution");
    add_key_option(*command, "--size", a->keys, "size");
    add_key_option(*command, "--background", a->keys, "background");
    command->add_option("--threshold", a->threshold, "smallest score of a counted box")
        ->check(CLI::Range(0.0, 1.0))
        ->capture_default_str();
    add_key_option(*command, "--renderer", a->renderer_keys, "renderer");
    add_key_option(*command, "--lit", a->renderer_keys, "lit");
    command->add_option("--out", a->out, "FILE.json with all answers");
    add_common_options(*command, common);
    command->callback([a, &common] { judge(*a, common); });
  }
}

// ---- video-score --------------------------------------------------------------------------

void print_video(const record::VideoRecord& record) {
  const auto line = [](const std::string& name, const record::FrameShare& share) {
    std::cout << fmt::format("{:<24} ASR {:.1f} % of {} frames\n", name, 100 * share.asr,
                             share.frames);
  };
  for (const record::VideoVictim& v : record.victims) {
    line(v.name, v.all);
    for (const auto& [label, share] : v.backgrounds) {
      line("  " + (label.empty() ? std::string("(no label)") : label), share);
    }
  }
}

void video_score(evaluate::VideoOptions& o, const std::string& out, const Common& common) {
  o.device = apply_common(common);
  const auto progress = make_progress(common);
  evaluate::ScoredVideo video = evaluate::score_video(o, *progress);
  if (!out.empty()) {
    evaluate::save(video, out);
    report::ReportInput page;
    page.title = o.video.filename().string() + ": frames and answers";
    page.videos = {run::load_video(out, video.record)};
    report::write_report(page, fs::path(out).replace_extension(".html"));
  }
  if (common.json)
    std::cout << to_json(video.record).dump(1) << "\n";
  else
    print_video(video.record);
}

void add_video_score(CLI::App& app, Common& common) {
  auto o = std::make_shared<evaluate::VideoOptions>();
  auto out = std::make_shared<std::string>();
  CLI::App* command =
      app.add_subcommand("video-score", "score the frames of a video of the printed object");
  command->add_option("VIDEO", o->video, "video file that ffmpeg can read")->required();
  command
      ->add_option(
          "--target", o->target,
          "class: index, WordNet id or name; for models with different labels SET=CLASS,SET=CLASS")
      ->required();
  command->add_option("--victims", o->victims, "models that are scored")->required();
  command->add_option("--true-class", o->true_class, "class of the object");
  command->add_option("--frames", o->frames, "number of frames, evenly spaced")
      ->check(CLI::Range(1, 100000))
      ->capture_default_str();
  CLI::Option* box =
      command->add_option("--box", o->box, "LEFT,TOP,WIDTH,HEIGHT in pixels of the upright frame");
  command->add_option("--mask", o->mask, "picture that is light at the object")->excludes(box);
  command->add_flag("--track", o->track, "follow the box of the first frame (OpenCV's CSRT)");
  command->add_option("--backgrounds", o->backgrounds, "CSV file: start_seconds,end_seconds,label");
  command->add_option("--time-limit", o->time_limit_seconds, "time limit, seconds")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--out", *out,
                      "FILE.json; also writes FILE.csv, FILE.html and the pictures in FILE.frames");
  add_common_options(*command, common);
  command->callback([o, out, &common] { video_score(*o, *out, common); });
}

}  // namespace

void add_tool_commands(CLI::App& app, Common& common) {
  add_export(app, common);
  add_print_check(app, common);
  add_print_sheet(app, common);
  add_judge(app, common);
  add_video_score(app, common);
}

}  // namespace tt3d::cli
