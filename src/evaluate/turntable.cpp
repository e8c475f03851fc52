#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>
#include <fmt/format.h>

#include <cmath>

#include "tt3d/asset.h"
#include "tt3d/evaluate.h"
#include "tt3d/image.h"
#include "tt3d/input_files.h"
#include "tt3d/scene.h"
#include "tt3d/tool.h"

namespace tt3d::evaluate {
namespace fs = std::filesystem;
using at::Tensor;

namespace {

constexpr double kEncodeSeconds = 3600;

}  // namespace

void render_turntable(const TurntableOptions& o, Progress& progress) {
  at::NoGradGuard guard;
  if (!has_extension(o.out, {".mp4"})) throw InputError(o.out, "expected a name that ends in .mp4");
  const asset::TexturedMesh asset = asset::load_asset(o.asset, &progress);
  const scene::ViewFrame frame = asset::view_frame(asset, o.asset);
  const auto count = static_cast<int64_t>(std::lround(o.seconds * o.frames_per_second)) * o.blur;
  if (count < 1) throw InputError("a video needs at least one frame; raise --seconds or --fps");
  std::vector<scene::SampledView> views;
  for (int64_t i = 0; i < count; ++i) {
    const double azimuth_deg = 360.0 * static_cast<double>(i) / static_cast<double>(count);
    views.push_back(scene::orbit_view(frame, azimuth_deg, o.elevation_deg, o.size));
  }
  const AssetViews pictures(o.asset, asset, views, o.renderer, o.device, progress);
  Random random(o.seed, "evaluate/background", 0);
  const Tensor behind = scene::Backgrounds(o.background).draw(o.size, o.size, random);
  const ExchangeFolder folder;
  progress.begin("frames", count, 0);
  for (int64_t i = 0; i < count; ++i) {
    const Tensor rgb = image::over_background(pictures.render(i, i + 1), behind.to(o.device))[0];
    write_file_atomic(folder / fmt::format("frame{:05}.png", i),
                      image::encode_png(image::to_uint8(rgb.cpu())));
    progress.update(i + 1, {});
    progress.check();
  }
  progress.end();
  if (!o.out.parent_path().empty()) make_folder(o.out.parent_path());
  (void)run_tool("make_video.py",
                 {(folder / "frame%05d.png").string(), std::to_string(o.frames_per_second),
                  std::to_string(o.blur), std::to_string(o.crf), fs::absolute(o.out).string()},
                 "encoding", kEncodeSeconds, progress);
}

}  // namespace tt3d::evaluate
