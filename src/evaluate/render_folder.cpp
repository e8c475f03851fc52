#include <ATen/ATen.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "tt3d/evaluate.h"
#include "tt3d/image.h"
#include "tt3d/json.h"

namespace tt3d::evaluate {
namespace {

using at::Tensor;
using nlohmann::json;

/// Converts premultiplied [H,W,4] to [H,W,4] uint8 with straight alpha.
Tensor straight(const Tensor& premultiplied) {
  const Tensor rgba = premultiplied.clamp(0, 1).cpu();
  const Tensor alpha = rgba.narrow(2, 3, 1);
  return image::to_uint8(at::cat({rgba.narrow(2, 0, 3) / alpha.clamp_min(1e-6), alpha}, 2));
}

/// `origin` is that of the asset, to which the camera is relative.
json frame_json(const scene::SampledView& view, const std::array<double, 3>& origin,
                const std::string& file) {
  json matrix = json::array();
  for (size_t row = 0; row < 4; ++row) {
    json line = json::array();
    for (size_t k = 0; k < 4; ++k) {
      const double moved = row < 3 && k == 3 ? origin[row] : 0;
      line.push_back(view.camera.camera_to_world[4 * row + k] + moved);
    }
    matrix.push_back(line);
  }
  return {{"file_path", file},
          {"azimuth_deg", view.azimuth_deg},
          {"elevation_deg", view.elevation_deg},
          {"distance", view.distance},
          {"roll_deg", view.roll_deg},
          {"transform_matrix", matrix}};
}

}  // namespace

void render_to_folder(const EvaluateOptions& o, const std::filesystem::path& out,
                      Progress& progress) {
  const asset::TexturedMesh asset = asset::load_asset(o.asset, &progress);
  const auto views = evaluation_views(o.view_distribution, o.seed, o.views, o.size,
                                      asset::view_frame(asset, o.asset));
  const AssetViews pictures(o.asset, asset, views, o.renderer, o.device, progress);
  json frames = json::array();
  progress.begin("render", o.views, 0);
  for (int64_t i = 0; i < o.views; ++i) {
    const std::string name = "r_" + std::to_string(i);
    write_file_atomic(out / "test" / (name + ".png"),
                      image::encode_png(straight(pictures.render(i, i + 1)[0])));
    frames.push_back(frame_json(views[static_cast<size_t>(i)], asset.origin, "./test/" + name));
    progress.update(i + 1, {});
    progress.check();
  }
  progress.end();
  const scene::Camera& camera = views[0].camera;
  const json transforms = {{"camera_angle_x", 2 * std::atan(0.5 * camera.width / camera.fx)},
                           {"frames", frames}};
  // Readers of the format need a training split and hold out some of its views themselves.
  write_json(out / "transforms_train.json", transforms);
}

}  // namespace tt3d::evaluate
