#include <ATen/ATen.h>
#include <fmt/format.h>

#include <cmath>

#include "tt3d/evaluate.h"
#include "tt3d/field.h"
#include "tt3d/tool.h"

namespace tt3d {
namespace fs = std::filesystem;
using at::Tensor;

namespace {

constexpr double kEncodeSeconds = 3600;
constexpr double kPi = 3.14159265358979323846;

/// A camera at an azimuth and elevation that looks at the frame's centre, +Z up.
Camera camera_at(const ViewFrame& frame, double azimuth, double elevation, int size) {
  const std::array<double, 3> back = {std::cos(elevation) * std::cos(azimuth),
                                      std::cos(elevation) * std::sin(azimuth), std::sin(elevation)};
  const std::array<double, 3> right = {-std::sin(azimuth), std::cos(azimuth), 0};
  const std::array<double, 3> up = {-std::sin(elevation) * std::cos(azimuth),
                                    -std::sin(elevation) * std::sin(azimuth), std::cos(elevation)};
  Camera camera;
  for (size_t k = 0; k < 3; ++k) {
    camera.camera_to_world[4 * k] = right[k];
    camera.camera_to_world[4 * k + 1] = up[k];
    camera.camera_to_world[4 * k + 2] = back[k];
    camera.camera_to_world[4 * k + 3] = frame.centre[k] + frame.distance * back[k];
  }
  camera.camera_to_world[15] = 1;
  camera.width = camera.height = size;
  camera.fx = camera.fy = 0.5 * size / std::tan(frame.fov_y_deg * kPi / 360);
  camera.cx = camera.cy = 0.5 * size;
  return camera;
}

}  // namespace

void render_turntable(const TurntableOptions& o, Progress& progress) {
  at::NoGradGuard guard;
  if (o.out.extension() != ".mp4") throw InputError(o.out, "expected a name that ends in .mp4");
  const TexturedMesh asset = load_asset(o.asset);
  const ViewFrame frame = asset_view_frame(asset, o.asset);
  const auto count = static_cast<int64_t>(std::lround(o.seconds * o.frames_per_second)) * o.blur;
  if (count < 1) throw InputError("a video needs at least one frame");
  std::vector<SampledView> views;
  for (int64_t i = 0; i < count; ++i) {
    SampledView view;
    view.azimuth_deg = 360.0 * static_cast<double>(i) / static_cast<double>(count);
    view.elevation_deg = o.elevation_deg;
    view.distance = frame.distance;
    view.camera =
        camera_at(frame, view.azimuth_deg * kPi / 180, o.elevation_deg * kPi / 180, o.size);
    views.push_back(view);
  }
  const AssetViews pictures(o.asset, asset, views, o.renderer, o.device, progress);
  Random random(o.seed, "evaluate/background", 0);
  const Tensor behind = Backgrounds(o.background).draw(o.size, o.size, random);
  const ExchangeFolder folder;
  progress.begin("frames", count, 0);
  for (int64_t i = 0; i < count; ++i) {
    const Tensor rgb = over_background(pictures.render(i, i + 1), behind.to(o.device))[0];
    write_file_atomic(folder / fmt::format("frame{:05}.png", i), encode_png(to_uint8(rgb.cpu())));
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

}  // namespace tt3d
