#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>

#include "tt3d/asset.h"
#include "tt3d/evaluate.h"
#include "tt3d/raster.h"
#include "tt3d/scene.h"

namespace tt3d::evaluate {

using at::Tensor;

AssetRenderer::AssetRenderer(const asset::TexturedMesh& asset, at::Device device)
    : asset_{asset.vertices.to(device), asset.faces.to(device), asset.map.to(device),
             asset.texture},
      texels_((asset.texture.to(at::kFloat) / 255).to(device)),
      twins_(raster::edge_twins(asset.faces).to(device)) {
  corner_uvs_ = asset_.map.uvs.index_select(0, asset_.map.faces.flatten().to(at::kLong));
  corner_index_ = asset_.faces.flatten().to(at::kLong);
  corner_faces_ = at::arange(corner_index_.size(0), asset_.faces.options()).view({-1, 3});
  extent_ = asset.vertices.norm(2, {1}).max().item<double>();
}

Tensor AssetRenderer::render(const std::vector<scene::Camera>& cameras) const {
  at::NoGradGuard guard;
  const int64_t height = cameras[0].height, width = cameras[0].width;
  const Tensor matrices = scene::clip_matrices(cameras, 1.05 * extent_ + 1e-6);
  const Tensor clip = scene::to_clip(asset_.vertices, matrices.to(asset_.vertices.device()));
  const Tensor rast = raster::rasterize(clip, asset_.faces, height, width);
  const Tensor uv = raster::interpolate(asset_.map.uvs, rast, asset_.map.faces);
  const Tensor derivatives = raster::attribute_derivatives(
      corner_uvs_, rast, clip.index_select(1, corner_index_), corner_faces_);
  const Tensor color = raster::texture(texels_, uv, derivatives, rast);
  const Tensor alpha = (rast.narrow(3, 3, 1) > 0).to(at::kFloat);
  return raster::antialias(at::cat({color, alpha}, 3), rast, clip, asset_.faces, twins_);
}

}  // namespace tt3d::evaluate
