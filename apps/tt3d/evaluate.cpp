#include <iostream>

#include "commands.h"
#include "tt3d/evaluate.h"

namespace tt3d::cli {
namespace {

struct Arguments {
  EvaluateOptions options;
  std::string out;
  int64_t views = 100;
  bool make_video = false;
  TurntableOptions video;
};

void evaluate(Arguments& a, const Common& common) {
  a.options.device = apply_common(common);
  check_renderer(a.options.renderer);
  a.options.seed = common.seed;
  const auto progress = make_progress(common);
  if (!a.options.lpips.empty() && a.options.lpips_backbone.empty()) {
    a.options.lpips_backbone = "models/lpips/" + a.options.lpips + ".pth";
  }
  const EvalRecord record = evaluate_asset(a.options, *progress);
  write_record(record, a.out);
  if (common.json)
    std::cout << record_json(record);
  else
    print_record(record_json(record));
}

/// `render --video`: once around, as MP4.
void turntable(const Arguments& a, const Common& common) {
  TurntableOptions video = a.video;
  video.asset = a.options.asset;
  video.out = a.out;
  video.size = a.options.size;
  video.background = a.options.background;
  video.renderer = a.options.renderer;
  video.seed = common.seed;
  video.device = apply_common(common);
  const auto progress = make_progress(common);
  render_turntable(video, *progress);
  std::cout << a.out << "\n";
}

void render(const Arguments& a, const Common& common) {
  if (a.make_video) return turntable(a, common);
  const at::Device device = apply_common(common);
  check_renderer(a.options.renderer);
  const auto progress = make_progress(common);
  render_to_folder(a.options.asset, a.options.view_distribution, a.views, a.options.size,
                   common.seed, a.out, *progress, device, a.options.renderer);
  std::cout << a.out << "\n";
}

void add_view_options(CLI::App& command, Arguments& a) {
  command.add_option("--views", a.views, "held-out random views")
      ->check(CLI::Range(1, 1000000))
      ->capture_default_str();
  command
      .add_option("--view-distribution", a.options.view_distribution, "ring, dome, sphere or paper")
      ->capture_default_str();
  command.add_option("--size", a.options.size, "pixels a side")
      ->check(CLI::Range(16, 8192))
      ->capture_default_str();
  RendererChoice& renderer = a.options.renderer;
  command.add_option("--renderer", renderer.name, "builtin, mitsuba, blender or meshlab")
      ->capture_default_str();
  command.add_flag("--lit", renderer.lit, "environment light, sun and ground; not builtin");
  command
      .add_option("--samples", renderer.samples,
                  "rays a pixel; default 1 builtin, 64 in lit Mitsuba, else 16")
      ->check(CLI::Range(1, 65536));
  command
      .add_option("--view-time-limit", renderer.time_limit_seconds,
                  "seconds a view before another renderer counts as hanging")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
}

}  // namespace

void add_evaluate_commands(CLI::App& app, Common& common) {
  auto a = std::make_shared<Arguments>();
  CLI::App* command = app.add_subcommand("evaluate", "scores any GLB or OBJ against classifiers");
  command->add_option("ASSET", a->options.asset, "GLB or OBJ")->required();
  command->add_option("--target", a->options.target, "class: index, WordNet id or name")
      ->required();
  command->add_option("--victims", a->options.victims, "models that are scored")->required();
  command->add_option("--true-class", a->options.true_class, "class of the object");
  command->add_option("--clean", a->options.clean, "the object before the attack");
  command->add_option("--background", a->options.background, "white, #rrggbb or a folder")
      ->capture_default_str();
  command->add_option("--out", a->out, "FILE.json; FILE.csv is written beside it")->required();
  command->add_option("--lpips", a->options.lpips, "vgg, alex or squeeze: LPIPS against --clean");
  command->add_option("--lpips-backbone", a->options.lpips_backbone,
                      "torchvision's weights of that network; default models/lpips/NET.pth");
  command->add_flag("--geometry", a->options.geometry,
                    "Chamfer, Hausdorff, normals, self-intersections against --clean");
  add_view_options(*command, *a);
  add_common_options(*command, common);
  command->callback([a, &common] {
    a->options.views = a->views;
    evaluate(*a, common);
  });

  CLI::App* picture = app.add_subcommand("render", "views of an asset as a NeRF-synthetic capture");
  picture->add_option("ASSET", a->options.asset, "GLB or OBJ")->required();
  picture->add_option("--out", a->out, "folder; with --video a file .mp4")->required();
  picture->add_flag("--video", a->make_video, "a video once around the object (ffmpeg)");
  picture->add_option("--seconds", a->video.seconds)->check(CLI::Range(0.04, 600.0));
  picture->add_option("--fps", a->video.frames_per_second)->check(CLI::Range(1, 120));
  picture->add_option("--elevation", a->video.elevation_deg, "degrees")
      ->check(CLI::Range(-85.0, 85.0));
  picture->add_option("--blur", a->video.blur, "pictures averaged to a frame: motion blur")
      ->check(CLI::Range(1, 64));
  picture->add_option("--crf", a->video.crf, "compression of H.264, 0 to 51")
      ->check(CLI::Range(0, 51));
  picture->add_option("--background", a->options.background, "of the video");
  add_view_options(*picture, *a);
  add_common_options(*picture, common);
  picture->callback([a, &common] { render(*a, common); });
}

}  // namespace tt3d::cli
