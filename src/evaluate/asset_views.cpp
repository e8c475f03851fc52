#include <ATen/ATen.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <utility>

#include "tt3d/asset.h"
#include "tt3d/evaluate.h"
#include "tt3d/image.h"
#include "tt3d/input_files.h"
#include "tt3d/scene.h"
#include "tt3d/tool.h"
#include "tt3d/version.h"

namespace tt3d::evaluate {
namespace fs = std::filesystem;
using at::Tensor;
using nlohmann::json;

namespace {

constexpr double kStartSeconds = 300;  ///< time to start a renderer and import the asset

/// Samples along one side of a pixel in the built-in renderer; 0 if their number is not a square.
int side_of(int samples) {
  const int side = static_cast<int>(std::lround(std::sqrt(samples)));
  return side * side == samples ? side : 0;
}

scene::Camera enlarged(scene::Camera camera, int factor) {
  camera.width *= factor;
  camera.height *= factor;
  for (double* length : {&camera.fx, &camera.fy, &camera.cx, &camera.cy}) *length *= factor;
  return camera;
}

/// The file that the renderer reads.
fs::path file_for(RendererName renderer, const fs::path& path, const asset::TexturedMesh& asset,
                  const ExchangeFolder& folder) {
  const bool moved = asset.origin != std::array{0.0, 0.0, 0.0};  // the cameras are relative to it
  const bool gltf = has_extension(path, {".gltf"});
  if (renderer == RendererName::kBlender && !moved && !gltf) return fs::absolute(path);
  const bool obj = has_extension(path, {".obj"});
  if (obj && !moved && read_file(path).starts_with("# tt3d ")) return fs::absolute(path);
  fs::create_directories(folder / "asset");
  asset::TexturedMesh placed = asset;
  placed.origin = {0, 0, 0};
  asset::write_obj(placed, folder / "asset/object.obj");
  return folder / "asset/object.obj";
}

json job_of(const RendererChoice& renderer, const asset::TexturedMesh& asset,
            const std::vector<scene::SampledView>& views, const ExchangeFolder& folder) {
  const Tensor low = std::get<0>(asset.vertices.min(0)), high = std::get<0>(asset.vertices.max(0));
  const Tensor centre = 0.5 * (low + high);
  const scene::Camera& first = views.front().camera;
  json list = json::array();
  for (size_t i = 0; i < views.size(); ++i) {
    list.push_back({{"camera_to_world", views[i].camera.camera_to_world},
                    {"file", (folder / ("view" + std::to_string(i) + ".png")).string()}});
  }
  return {{"renderer", name_of(renderer.name)},
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
  if (renderer.name != RendererName::kBuiltin) return;
  if (renderer.lit) {
    throw InputError(
        "the built-in renderer does not support lighting; choose mitsuba, blender or meshlab");
  }
  if (side_of(samples_of(renderer)) == 0 || renderer.samples > 64) {
    throw InputError("samples " + std::to_string(renderer.samples) +
                     ": the built-in renderer takes a square number of at most 64 (1, 4, 9, ...)");
  }
}

// With light, 8 samples take Blender less than a second per view on two cores. Mitsuba's sampler is
// noisier and faster.
int samples_of(const RendererChoice& renderer) {
  if (renderer.samples > 0) return renderer.samples;
  if (renderer.name == RendererName::kBuiltin) return 1;
  if (!renderer.lit) return 16;
  return renderer.name == RendererName::kMitsuba ? 64 : 8;
}

struct AssetViews::Parts {
  std::vector<scene::SampledView> views;
  std::optional<AssetRenderer> builtin;
  int side = 1;                            ///< samples along one side of a pixel, built-in renderer
  std::unique_ptr<ExchangeFolder> folder;  ///< pictures of the other renderers
  std::string version = kVersion;
};

AssetViews::AssetViews(const fs::path& path, const asset::TexturedMesh& asset,
                       std::vector<scene::SampledView> views, const RendererChoice& renderer,
                       at::Device device, Progress& progress)
    : parts_(std::make_unique<Parts>()) {
  check_renderer(renderer);
  parts_->views = std::move(views);
  if (renderer.name == RendererName::kBuiltin) {
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
  (void)run_tool("render_views.py", {(folder / "job.json").string()}, name_of(renderer.name), limit,
                 progress);
  parts_->version = read_file(folder / "version");
}

AssetViews::~AssetViews() = default;
AssetViews::AssetViews(AssetViews&&) noexcept = default;
AssetViews& AssetViews::operator=(AssetViews&&) noexcept = default;

const std::string& AssetViews::version() const { return parts_->version; }

Tensor AssetViews::render(int64_t begin, int64_t end) const {
  if (parts_->builtin && parts_->side == 1) {
    std::vector<scene::Camera> cameras;
    for (int64_t i = begin; i < end; ++i) cameras.push_back(parts_->views.at(i).camera);
    return parts_->builtin->render(cameras);
  }
  std::vector<Tensor> pictures;
  for (int64_t i = begin; i < end; ++i) {
    if (parts_->builtin) {
      const scene::Camera camera = enlarged(parts_->views.at(i).camera, parts_->side);
      pictures.push_back(image::average_pixels(parts_->builtin->render({camera}), parts_->side)[0]);
      continue;
    }
    const fs::path file = *parts_->folder / ("view" + std::to_string(i) + ".png");
    pictures.push_back(image::premultiplied(image::read_image(file)));
  }
  return at::stack(pictures);
}

}  // namespace tt3d::evaluate
