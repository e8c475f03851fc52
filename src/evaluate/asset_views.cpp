#include <ATen/ATen.h>

#include <algorithm>
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

/// Rays a pixel. Blender's picture of 16 is within 42 dB of that of 64, at a quarter of the time;
/// Mitsuba's sampler is noisier and faster.
int samples_of(const RendererChoice& renderer) {
  if (renderer.samples > 0) return renderer.samples;
  return renderer.lit && renderer.name == "mitsuba" ? 64 : 16;
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
}

struct AssetViews::Parts {
  std::vector<SampledView> views;
  std::optional<AssetRenderer> builtin;
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
  std::vector<Camera> cameras;
  std::vector<Tensor> pictures;
  for (int64_t i = begin; i < end; ++i) {
    cameras.push_back(parts_->views[static_cast<size_t>(i)].camera);
    if (parts_->builtin) continue;
    const fs::path file = *parts_->folder / ("view" + std::to_string(i) + ".png");
    const Tensor rgba = read_image(file).to(at::kFloat) / 255;
    const Tensor alpha = rgba.narrow(2, 3, 1);
    pictures.push_back(at::cat({rgba.narrow(2, 0, 3) * alpha, alpha}, 2));
  }
  return parts_->builtin ? parts_->builtin->render(cameras) : at::stack(pictures);
}

}  // namespace tt3d
