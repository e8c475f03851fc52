#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "tt3d/evaluate.h"
#include "tt3d/mesh.h"
#include "tt3d/raster.h"

namespace tt3d {
namespace {

using at::Tensor;
using nlohmann::json;

constexpr const char* kFrameFile = "views.json";

ViewFrame frame_from_bounds(const TexturedMesh& asset) {
  const Tensor low = std::get<0>(asset.vertices.min(0)), high = std::get<0>(asset.vertices.max(0));
  ViewFrame frame;
  for (int64_t k = 0; k < 3; ++k) {
    frame.centre[k] = 0.5 * (low[k].item<double>() + high[k].item<double>());
  }
  frame.radius = 0.5 * (high - low).norm().item<double>();
  frame.fov_y_deg = 40;
  // The bounding sphere just fits the picture at the nearest distance of `dome`.
  constexpr double kPi = 3.14159265358979;
  frame.distance = frame.radius / std::sin(frame.fov_y_deg * kPi / 360) / 0.95;
  return frame;
}

}  // namespace

ViewFrame asset_view_frame(const TexturedMesh& asset, const std::filesystem::path& asset_path) {
  const auto path = asset_path.parent_path() / kFrameFile;
  if (!std::filesystem::exists(path)) return frame_from_bounds(asset);
  try {
    const json j = json::parse(read_file(path));
    ViewFrame frame;
    frame.centre = j.at("centre").get<std::array<double, 3>>();
    frame.radius = j.at("radius").get<double>();
    frame.distance = j.at("distance").get<double>();
    frame.fov_y_deg = j.at("fov_y_deg").get<double>();
    if (!(frame.radius > 0) || !(frame.distance > 0) || !(frame.fov_y_deg > 0)) {
      throw InputError(path, "radius, distance and fov_y_deg must be positive");
    }
    return frame;
  } catch (const json::exception& error) {
    throw InputError(path,
                     std::string("expected centre, radius, distance, fov_y_deg: ") + error.what());
  }
}

void write_view_frame(const ViewFrame& frame, const std::filesystem::path& folder) {
  const json j = {{"centre", frame.centre},
                  {"radius", frame.radius},
                  {"distance", frame.distance},
                  {"fov_y_deg", frame.fov_y_deg}};
  write_file_atomic(folder / kFrameFile, j.dump(1) + "\n");
}

AssetRenderer::AssetRenderer(const TexturedMesh& asset, at::Device device)
    : asset_{asset.vertices.to(device), asset.faces.to(device), asset.uvs.to(device),
             asset.uv_faces.to(device), asset.texture},
      texels_((asset.texture.to(at::kFloat) / 255).to(device)),
      twins_(edge_twins(asset.faces).to(device)) {
  corner_uvs_ = asset_.uvs.index_select(0, asset_.uv_faces.flatten().to(at::kLong));
  corner_index_ = asset_.faces.flatten().to(at::kLong);
  corner_faces_ = at::arange(corner_index_.size(0), asset_.faces.options()).view({-1, 3});
  extent_ = asset.vertices.norm(2, {1}).max().item<double>();
}

Tensor AssetRenderer::render(const std::vector<Camera>& cameras) const {
  at::NoGradGuard guard;
  const int64_t height = cameras[0].height, width = cameras[0].width;
  const Tensor matrices = clip_matrices(cameras, 1.05 * extent_ + 1e-6);
  const Tensor clip = to_clip(asset_.vertices, matrices.to(asset_.vertices.device()));
  const Tensor rast = rasterize(clip, asset_.faces, height, width);
  const Tensor uv = interpolate(asset_.uvs, rast, asset_.uv_faces);
  const Tensor derivatives =
      attribute_derivatives(corner_uvs_, rast, clip.index_select(1, corner_index_), corner_faces_);
  const Tensor color = texture(texels_, uv, derivatives, rast);
  const Tensor alpha = (rast.narrow(3, 3, 1) > 0).to(at::kFloat);
  return antialias(at::cat({color, alpha}, 3), rast, clip, asset_.faces, twins_);
}

}  // namespace tt3d
