#include <ATen/ATen.h>
#include <fmt/format.h>

#include <cmath>
#include <fstream>
#include <iostream>
#include <nlohmann/json.hpp>

#include "commands.h"
#include "tt3d/evaluate.h"
#include "tt3d/report.h"
#include "tt3d/run.h"
#include "tt3d/tensor_file.h"
#include "tt3d/tool.h"

/// Commands whose work is done by the tools in Python: export, print-check, print-sheet, judge;
/// and video-score.
namespace tt3d::cli {
namespace fs = std::filesystem;
using nlohmann::json;
namespace {

constexpr double kToolSeconds = 1800;

/// The longest side of the bounding box.
double longest_side(const TexturedMesh& mesh) {
  const at::Tensor span = std::get<0>(mesh.vertices.max(0)) - std::get<0>(mesh.vertices.min(0));
  return span.max().item<double>();
}

void write_asset(TexturedMesh mesh, const fs::path& out, double size_mm, Progress& progress) {
  const std::string kind = out.extension().string();
  if (kind == ".glb" || kind == ".obj") {
    if (size_mm > 0) mesh.vertices = mesh.vertices * (size_mm / longest_side(mesh));
    kind == ".glb" ? write_glb(mesh, out) : write_obj(mesh, out);
    return;
  }
  if (kind != ".3mf" && kind != ".stl" && kind != ".ply") {
    throw InputError(out, "expected .glb, .obj, .ply, .3mf or .stl");
  }
  if (!out.parent_path().empty()) make_folder(out.parent_path());
  const ExchangeFolder folder;
  save_mesh_tensors(mesh, folder / "mesh.safetensors");
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
  CLI::App* command = app.add_subcommand("export", "an asset as GLB, OBJ, PLY, 3MF or STL");
  command->add_option("ASSET", a->asset, "GLB or OBJ")->required();
  command->add_option("--out", a->out, "FILE.glb, .obj, .ply, .3mf or .stl")->required();
  command->add_option("--size-mm", a->size_mm, "longest side; default: the asset's own units")
      ->check(CLI::PositiveNumber);
  add_common_options(*command, common);
  command->callback([a, &common] {
    (void)apply_common(common);
    const auto progress = make_progress(common);
    write_asset(load_asset(a->asset), a->out, a->size_mm, *progress);
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
    throw InputError("--flat-base changes the mesh: name a file for it with --repair");
  }
  const auto progress = make_progress(common);
  TexturedMesh mesh = load_asset(a.asset);
  const ExchangeFolder folder;
  save_mesh_tensors(mesh, folder / "mesh.safetensors");
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
    mesh.uvs = mended.get("uvs", {-1, 2}, at::kFloat);
    mesh.uv_faces = mended.get("uv_faces", {-1, 3}, at::kInt);
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
      app.add_subcommand("print-check", "what a 3D printer would stumble over, with advice");
  command->add_option("ASSET", a->asset, "GLB or OBJ")->required();
  command->add_option("--size-mm", a->size_mm, "longest side of the print")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--wall-mm", a->wall_mm, "thinnest wall the printer makes")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--overhang-deg", a->overhang_deg, "from the vertical, free of supports")
      ->check(CLI::Range(0, 90))
      ->capture_default_str();
  command->add_option("--gamut", a->gamut, "file with a printable colour #rrggbb a line");
  command->add_option("--flat-base", a->flat_base_mm, "mm at the bottom that --repair presses flat")
      ->check(CLI::NonNegativeNumber);
  command->add_option("--repair", a->repair, "file for the mended asset, at --size-mm");
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
  CLI::App* command =
      app.add_subcommand("print-sheet", "a page with scale bar and protocol for filming a print");
  command->add_option("--out", a->out, "FILE.svg")->required();
  command->add_option("--object", a->object, "its name on the page")->capture_default_str();
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
  std::string task, asset, text, model, distribution = "dome", background = "white", out;
  int64_t views = 20;
  int size = 400;
  double threshold = 0.3;
  RendererChoice renderer;
};

/// "a hot dog. a teddy bear." as phrases.
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

/// Pictures of an asset over its background as PNG files.
json write_pictures(const JudgeArguments& a, const Common& common, const ExchangeFolder& folder,
                    Progress& progress) {
  const TexturedMesh mesh = load_asset(a.asset);
  const auto views = evaluation_views(a.distribution, common.seed, a.views, a.size,
                                      asset_view_frame(mesh, a.asset));
  const AssetViews pictures(a.asset, mesh, views, a.renderer, apply_common(common), progress);
  const Backgrounds backgrounds(a.background);
  json files = json::array();
  for (int64_t i = 0; i < a.views; ++i) {
    const at::Tensor rgba = pictures.render(i, i + 1)[0].cpu();
    Random random(common.seed, "evaluate/background", static_cast<uint64_t>(i));
    const at::Tensor rgb = rgba.narrow(2, 0, 3) +
                           (1 - rgba.narrow(2, 3, 1)) * backgrounds.draw(a.size, a.size, random);
    const fs::path file = folder / fmt::format("judged{}.png", i);
    write_file_atomic(file, encode_png(to_uint8(rgb)));
    files.push_back(file.string());
  }
  return files;
}

void judge(const JudgeArguments& a, const Common& common) {
  const auto progress = make_progress(common);
  const auto phrases = phrases_in(a.text);
  const ExchangeFolder folder;
  const json job = {
      {"task", a.task},
      {"model", fs::absolute(a.model.empty() ? "models/judges/" + a.task : a.model).string()},
      {"texts", phrases},
      {"threshold", a.threshold},
      {"pictures", write_pictures(a, common, folder, *progress)},
      {"out", (folder / "answers.json").string()}};
  write_file_atomic(folder / "job.json", job.dump());
  (void)run_tool("judge.py", {(folder / "job.json").string()}, "judge", kToolSeconds, *progress);
  json result = json::parse(read_file(folder / "answers.json"));
  result["asset"] = a.asset;
  result["renderer"] = {{"name", a.renderer.name}, {"lit", a.renderer.lit}};
  result["background"] = a.background;
  result["views"] = {{"distribution", a.distribution}, {"count", a.views}, {"seed", common.seed}};
  if (!a.out.empty()) write_file_atomic(a.out, result.dump(1) + "\n");
  if (common.json) {
    std::cout << result.dump(1) << "\n";
    return;
  }
  for (const std::string& phrase : phrases) {
    std::cout << fmt::format("{:<24} found in {:.1f} % of {} views\n", phrase,
                             100 * result["shares"][phrase].get<double>(), a.views);
  }
}

void add_judge(CLI::App& app, Common& common) {
  CLI::App* group = app.add_subcommand("judge", "other tasks: detection, captions, zero-shot");
  group->require_subcommand(1);
  for (const auto& [task, words] : {std::pair{"detect", "zero-shot detection with Grounding DINO"},
                                    {"caption", "captions with BLIP"},
                                    {"zeroshot", "zero-shot classification with CLIP"}}) {
    auto a = std::make_shared<JudgeArguments>();
    a->task = task;
    CLI::App* command = group->add_subcommand(task, words);
    command->add_option("ASSET", a->asset, "GLB or OBJ")->required();
    command->add_option("--text", a->text, "phrases: what the object is. what it should be.")
        ->required();
    command->add_option("--model", a->model, "folder of the model; default models/judges/TASK");
    command->add_option("--views", a->views)->check(CLI::Range(1, 100000))->capture_default_str();
    command->add_option("--view-distribution", a->distribution)->capture_default_str();
    command->add_option("--size", a->size)->check(CLI::Range(16, 8192))->capture_default_str();
    command->add_option("--background", a->background)->capture_default_str();
    command->add_option("--threshold", a->threshold, "of a box's score")
        ->check(CLI::Range(0.0, 1.0))
        ->capture_default_str();
    command->add_option("--renderer", a->renderer.name)->capture_default_str();
    command->add_flag("--lit", a->renderer.lit);
    command->add_option("--out", a->out, "FILE.json with every answer");
    add_common_options(*command, common);
    command->callback([a, &common] { judge(*a, common); });
  }
}

// ---- video-score --------------------------------------------------------------------------

void video_score(VideoOptions& o, const std::string& out, const Common& common) {
  o.device = apply_common(common);
  const auto progress = make_progress(common);
  const VideoRecord record = score_video(o, *progress);
  const std::string text = video_json(record);
  if (!out.empty()) {
    write_video_record(record, out);
    ReportInput page;
    page.title = o.video.filename().string() + ": frames and answers";
    page.videos = {read_video(out)};
    write_report(page, fs::path(out).replace_extension(".html"));
  }
  if (common.json) {
    std::cout << text;
    return;
  }
  const json j = json::parse(text);
  for (const json& v : j["victims"]) {
    std::cout << fmt::format("{:<24} ASR {:.1f} % of {} frames\n", v["name"].get<std::string>(),
                             100 * v["asr"].get<double>(), v["frames"].get<int64_t>());
    for (const auto& [label, one] : v["backgrounds"].items()) {
      std::cout << fmt::format("  {:<22} ASR {:.1f} % of {} frames\n",
                               label.empty() ? "(no label)" : label, 100 * one["asr"].get<double>(),
                               one["frames"].get<int64_t>());
    }
  }
}

void add_video_score(CLI::App& app, Common& common) {
  auto o = std::make_shared<VideoOptions>();
  auto out = std::make_shared<std::string>();
  CLI::App* command =
      app.add_subcommand("video-score", "scores the frames of a video of the printed object");
  command->add_option("VIDEO", o->video, "any file that ffmpeg reads")->required();
  command->add_option("--target", o->target, "class: index, WordNet id or name")->required();
  command->add_option("--victims", o->victims, "models that are scored")->required();
  command->add_option("--true-class", o->true_class, "class of the object");
  command->add_option("--frames", o->frames, "sampled evenly")
      ->check(CLI::Range(1, 100000))
      ->capture_default_str();
  CLI::Option* box =
      command->add_option("--box", o->box, "LEFT,TOP,WIDTH,HEIGHT in pixels, upright frame");
  command->add_option("--mask", o->mask, "picture: light where the object is")->excludes(box);
  command->add_flag("--track", o->track, "follow the box of the first frame (OpenCV's CSRT)");
  command->add_option("--backgrounds", o->backgrounds, "CSV: start_seconds,end_seconds,label");
  command->add_option("--time-limit", o->time_limit_seconds, "seconds")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--out", *out,
                      "FILE.json; beside it FILE.csv, FILE.html and the pictures in FILE.frames");
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
