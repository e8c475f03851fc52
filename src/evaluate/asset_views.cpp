#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <utility>

#include "tt3d/evaluate.h"
#include "tt3d/tool.h"
#include "tt3d/version.h"

namespace tt3d {
namespace fs = std::filesystem;
using at::Tensor;
using nlohmann::json;

namespace {

constexpr double kStartSeconds = 300;  ///< a renderer's start and its import of the asset

/// Pictures a side of a pixel in the built-in renderer; 0 where its samples are no square.
int side_of(int samples) {
  const int side = static_cast<int>(std::lround(std::sqrt(samples)));
  return side * side == samples ? side : 0;
}

Camera enlarged(Camera camera, int factor) {
  camera.width *= factor;
  camera.height *= factor;
  for (double* length : {&camera.fx, &camera.fy, &camera.cx, &camera.cy}) *length *= factor;
  return camera;
}

const std::vector<std::string>& renderer_names() {
  static const std::vector<std::string> names = {"builtin", "mitsuba", "blender", "meshlab"};
  return names;
}

/// The file that the renderer is given.
fs::path file_for(const std::string& renderer, const fs::path& path, const TexturedMesh& asset,
                  const ExchangeFolder& folder) {
  const bool obj = path.extension() == ".obj";
  if (renderer == "blender") return fs::absolute(path);
  if (obj && read_file(path).starts_with("# tt3d ")) return fs::absolute(path);
  fs::create_directories(folder / "asset");
  write_obj(asset, folder / "asset/object.obj");
  return folder / "asset/object.obj";
}

json job_of(const RendererChoice& renderer, const TexturedMesh& asset,
            const std::vector<SampledView>& views, const ExchangeFolder& folder) {
  const Tensor low = std::get<0>(asset.vertices.min(0)), high = std::get<0>(asset.vertices.max(0));
  const Tensor centre = 0.5 * (low + high);
  const Camera& first = views.front().camera;
  json list = json::array();
  for (size_t i = 0; i < views.size(); ++i) {
    list.push_back({{"camera_to_world", views[i].camera.camera_to_world},
                    {"file", (folder / ("view" + std::to_string(i) + ".png")).string()}});
  }
  return {{"renderer", renderer.name},
          {"lit", renderer.lit},
          {"samples", samples_of(renderer)},
          {"time_limit", renderer.time_limit_seconds},
          {"width", first.width},
          {"height", first.height},
          {"fx", first.fx},
          {"cx", first.cx},
          {"cy", first.cy},
          {"centre", {centre[0].item<float>(), centre[1].item<float>(), centre[2].item<float>()}},
          {"radius", 0.5 * (high - low).norm().item<double>()},
          {"floor", low[2].item<float>()},
          {"work", folder.path().string()},
          {"version_file", (folder / "version").string()},
          {"views", list}};
}

}  // namespace

void check_renderer(const RendererChoice& renderer) {
  const auto& names = renderer_names();
  if (std::find(names.begin(), names.end(), renderer.name) == names.end()) {
    throw InputError("renderer '" + renderer.name +
                     "': expected builtin, mitsuba, blender or meshlab");
  }
  if (renderer.lit && renderer.name == "builtin") {
    throw InputError("the built-in renderer knows no light; choose mitsuba, blender or meshlab");
  }
  if (renderer.name == "builtin" && (side_of(samples_of(renderer)) == 0 || renderer.samples > 64)) {
    throw InputError("samples " + std::to_string(renderer.samples) +
                     ": the built-in renderer takes a square number of at most 64 (1, 4, 9, ...)");
  }
}

// Lit, 8 rays keep Blender within a second a view on two cores; Mitsuba's sampler is noisier and
// faster.
int samples_of(const RendererChoice& renderer) {
  if (renderer.samples > 0) return renderer.samples;
  if (renderer.name == "builtin") return 1;
  if (!renderer.lit) return 16;
  return renderer.name == "mitsuba" ? 64 : 8;
}

Tensor average_pixels(const Tensor& pictures, int64_t factor) {
  const Tensor alpha = pictures.narrow(3, 3, 1);
  const Tensor srgb = (pictures.narrow(3, 0, 3) / alpha.clamp_min(1e-6)).clamp(0, 1);
  const Tensor light = at::where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055).pow(2.4));
  const Tensor mean =
      at::avg_pool2d(at::cat({light * alpha, alpha}, 3).permute({0, 3, 1, 2}), factor)
          .permute({0, 2, 3, 1});
  const Tensor share = mean.narrow(3, 3, 1);
  const Tensor inside = (mean.narrow(3, 0, 3) / share.clamp_min(1e-6)).clamp(0, 1);
  const Tensor shown = at::where(inside <= 0.0031308, 12.92 * inside,
                                 1.055 * inside.clamp_min(1e-8).pow(1 / 2.4) - 0.055);
  return at::cat({shown * share, share}, 3).contiguous();
}

struct AssetViews::Parts {
  std::vector<SampledView> views;
  std::optional<AssetRenderer> builtin;
  int side = 1;                            ///< the built-in renderer's samples are side by side
  std::unique_ptr<ExchangeFolder> folder;  ///< of the other renderers' pictures
  std::string version = kVersion;
};

AssetViews::AssetViews(const fs::path& path, const TexturedMesh& asset,
                       std::vector<SampledView> views, const RendererChoice& renderer,
                       at::Device device, Progress& progress)
    : parts_(std::make_unique<Parts>()) {
  check_renderer(renderer);
  parts_->views = std::move(views);
  if (renderer.name == "builtin") {
    parts_->builtin.emplace(asset, device);
    parts_->side = side_of(samples_of(renderer));
    return;
  }
  parts_->folder = std::make_unique<ExchangeFolder>();
  const ExchangeFolder& folder = *parts_->folder;
  json job = job_of(renderer, asset, parts_->views, folder);
  job["asset"] = file_for(renderer.name, path, asset, folder).string();
  write_file_atomic(folder / "job.json", job.dump());
  const double limit =
      kStartSeconds + renderer.time_limit_seconds * static_cast<double>(parts_->views.size());
  (void)run_tool("render_views.py", {(folder / "job.json").string()}, renderer.name, limit,
                 progress);
  parts_->version = read_file(folder / "version");
}

AssetViews::~AssetViews() = default;
AssetViews::AssetViews(AssetViews&&) noexcept = default;
AssetViews& AssetViews::operator=(AssetViews&&) noexcept = default;

const std::string& AssetViews::version() const { return parts_->version; }

Tensor AssetViews::render(int64_t begin, int64_t end) const {
  if (parts_->builtin && parts_->side == 1) {
    std::vector<Camera> cameras;
    for (int64_t i = begin; i < end; ++i) cameras.push_back(parts_->views.at(i).camera);
    return parts_->builtin->render(cameras);
  }
  std::vector<Tensor> pictures;
  for (int64_t i = begin; i < end; ++i) {
    if (parts_->builtin) {
      const Camera camera = enlarged(parts_->views.at(i).camera, parts_->side);
      pictures.push_back(average_pixels(parts_->builtin->render({camera}), parts_->side)[0]);
      continue;
    }
    const fs::path file = *parts_->folder / ("view" + std::to_string(i) + ".png");
    const Tensor rgba = read_image(file).to(at::kFloat) / 255;
    const Tensor alpha = rgba.narrow(2, 3, 1);
    pictures.push_back(at::cat({rgba.narrow(2, 0, 3) * alpha, alpha}, 2));
  }
  return at::stack(pictures);
}

}  // namespace tt3d
