#include <iostream>

#include "commands.h"
#include "key_options.h"
#include "tt3d/evaluate.h"

namespace tt3d::cli {
namespace {

struct EvaluateArguments {
  evaluate::EvaluateOptions options;
  KeyList keys, renderer_keys;  ///< keys of the options
  std::string out;
  bool make_video = false;
  evaluate::TurntableOptions video;

  EvaluateArguments() {
    options.keys(keys);
    options.renderer.keys(renderer_keys);
  }
};

void apply(EvaluateArguments& a, const Common& common) {
  a.options.device = apply_common(common);
  a.options.seed = common.seed;
  evaluate::check_renderer(a.options.renderer);
}

void evaluate(EvaluateArguments& a, const Common& common) {
  apply(a, common);
  const auto progress = make_progress(common);
  asset::AssetFiles assets;
  const record::EvaluationRecord record = evaluate::evaluate_asset(a.options, assets, *progress);
  record::save(record, a.out);
  print_record(record, common);
}

/// `render --video`: a video once around the object.
void turntable(const EvaluateArguments& a, const Common& common) {
  evaluate::TurntableOptions video = a.video;
  video.asset = a.options.asset;
  video.out = a.out;
  video.size = a.options.size;
  video.background = a.options.background;
  video.renderer = a.options.renderer;
  video.seed = common.seed;
  video.device = apply_common(common);
  const auto progress = make_progress(common);
  evaluate::render_turntable(video, *progress);
  std::cout << a.out << "\n";
}

void render(EvaluateArguments& a, const Common& common) {
  if (std::filesystem::exists(a.options.asset / "run.json")) {
    a.options.asset = clean_asset(a.options.asset, common);
  }
  if (a.make_video) return turntable(a, common);
  apply(a, common);
  const auto progress = make_progress(common);
  evaluate::render_to_folder(a.options, a.out, *progress);
  std::cout << a.out << "\n";
}

void add_view_options(CLI::App& command, EvaluateArguments& a) {
  add_key_option(command, "--views", a.keys, "views");
  add_key_option(command, "--view-distribution", a.keys, "view_distribution");
  add_key_option(command, "--size", a.keys, "size");
  add_key_option(command, "--renderer", a.renderer_keys, "renderer");
  add_key_option(command, "--lit", a.renderer_keys, "lit");
  add_key_option(command, "--samples", a.renderer_keys, "samples");
  add_key_option(command, "--view-time-limit", a.renderer_keys, "view_time_limit");
}

void add_evaluate(CLI::App& app, Common& common) {
  auto a = std::make_shared<EvaluateArguments>();
  CLI::App* command = app.add_subcommand("evaluate", "score any GLB, glTF or OBJ with classifiers");
  command->add_option("ASSET", a->options.asset, "GLB, glTF or OBJ")->required();
  command
      ->add_option(
          "--target", a->options.target,
          "class: index, WordNet id or name; for models with different labels SET=CLASS,SET=CLASS")
      ->required();
  add_key_option(*command, "--victims", a->keys, "victims")->required();
  add_key_option(*command, "--true-class", a->keys, "true_class");
  command->add_option("--clean", a->options.clean, "file of the object before the attack");
  add_key_option(*command, "--background", a->keys, "background");
  command->add_option("--out", a->out, "FILE.json; also writes FILE.csv beside it")->required();
  add_key_option(*command, "--lpips", a->keys, "lpips");
  add_key_option(*command, "--lpips-backbone", a->keys, "lpips_backbone");
  add_key_option(*command, "--geometry", a->keys, "geometry");
  add_view_options(*command, *a);
  add_common_options(*command, common);
  command->callback([a, &common] { evaluate(*a, common); });
}

void add_render(CLI::App& app, Common& common) {
  auto a = std::make_shared<EvaluateArguments>();
  CLI::App* command = app.add_subcommand(
      "render",
      "render views of an asset, or of a run's reconstructed object, as a NeRF-synthetic capture");
  command
      ->add_option("ASSET", a->options.asset,
                   "GLB, glTF or OBJ; or a run folder: the object before any attack")
      ->required();
  command->add_option("--out", a->out, "output folder; with --video an .mp4 file")->required();
  command->add_flag("--video", a->make_video, "render a video once around the object (ffmpeg)");
  command->add_option("--seconds", a->video.seconds, "length of the video, seconds")
      ->check(CLI::Range(0.04, 600.0))
      ->capture_default_str();
  command->add_option("--fps", a->video.frames_per_second, "frames per second of the video")
      ->check(CLI::Range(1, 120))
      ->capture_default_str();
  command->add_option("--elevation", a->video.elevation_deg, "degrees")
      ->check(CLI::Range(-85.0, 85.0))
      ->capture_default_str();
  command->add_option("--blur", a->video.blur, "pictures averaged per frame (motion blur)")
      ->check(CLI::Range(1, 64))
      ->capture_default_str();
  command->add_option("--crf", a->video.crf, "compression of H.264, 0 (lossless) to 51")
      ->check(CLI::Range(0, 51))
      ->capture_default_str();
  add_key_option(*command, "--background", a->keys, "background");
  add_view_options(*command, *a);
  add_common_options(*command, common);
  command->callback([a, &common] { render(*a, common); });
}

}  // namespace

void add_evaluate_commands(CLI::App& app, Common& common) {
  add_evaluate(app, common);
  add_render(app, common);
}

}  // namespace tt3d::cli
