#include <ATen/ATen.h>

#include <cmath>
#include <numbers>

#include "tt3d/asset.h"
#include "tt3d/json.h"
#include "tt3d/linear.h"

namespace tt3d::asset {
namespace {

using at::Tensor;

constexpr const char* kFrameFile = "views.json";

scene::ViewFrame frame_from_bounds(const TexturedMesh& asset) {
  const Tensor low = std::get<0>(asset.vertices.min(0)), high = std::get<0>(asset.vertices.max(0));
  scene::ViewFrame frame;
  for (int64_t k = 0; k < 3; ++k) {
    frame.centre[k] = 0.5 * (low[k].item<double>() + high[k].item<double>());
  }
  frame.radius = 0.5 * (high - low).norm().item<double>();
  frame.fov_y_deg = 40;
  // The bounding sphere just fits the picture at the nearest distance of `dome`.
  constexpr double kNearest = 0.95;
  frame.distance = frame.radius / std::sin(frame.fov_y_deg * std::numbers::pi / 360) / kNearest;
  return frame;
}

}  // namespace

const TexturedMesh& AssetFiles::load(const std::filesystem::path& path, Progress* progress) {
  const auto found = loaded_.find(path);
  if (found != loaded_.end()) return found->second;
  TexturedMesh mesh = load_asset(path, progress);
  if (!origin_) origin_ = mesh.origin;
  if (mesh.origin != *origin_) {
    const Tensor shift = at::empty({3}, at::kDouble);
    for (size_t k = 0; k < 3; ++k) {
      shift[static_cast<int64_t>(k)] = mesh.origin[k] - (*origin_)[k];
    }
    mesh.vertices = (mesh.vertices.to(at::kDouble) + shift).to(at::kFloat);
    mesh.origin = *origin_;
  }
  return loaded_.emplace(path, std::move(mesh)).first->second;
}

scene::ViewFrame view_frame(const TexturedMesh& asset, const std::filesystem::path& asset_path) {
  const auto path = asset_path.parent_path() / kFrameFile;
  if (!std::filesystem::exists(path)) return frame_from_bounds(asset);
  const nlohmann::json document = read_json(path);
  const JsonValue value(document, path);
  scene::ViewFrame frame;
  frame.centre = value.at("centre").as<std::array<double, 3>>();
  for (size_t k = 0; k < 3; ++k) frame.centre[k] -= asset.origin[k];
  frame.radius = value.at("radius").as<double>();
  frame.distance = value.at("distance").as<double>();
  frame.fov_y_deg = value.at("fov_y_deg").as<double>();
  if (value.has("up")) {
    frame.up = scene::linear::normalized(value.at("up").as<std::array<double, 3>>());
  }
  if (!(frame.radius > 0) || !(frame.distance > 0) || !(frame.fov_y_deg > 0)) {
    throw InputError(path, "radius, distance and fov_y_deg must be positive");
  }
  return frame;
}

void write_view_frame(const scene::ViewFrame& frame, const std::filesystem::path& folder) {
  nlohmann::json values = {{"centre", frame.centre},
                           {"radius", frame.radius},
                           {"distance", frame.distance},
                           {"fov_y_deg", frame.fov_y_deg}};
  if (frame.up[2] != 1) values["up"] = frame.up;
  write_json(folder / kFrameFile, values);
}

}  // namespace tt3d::asset
