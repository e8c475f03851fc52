#include <ATen/ATen.h>

#include "tt3d/mesh.h"
#include "tt3d/raster.h"
#include "tt3d/scene.h"

namespace tt3d::mesh {

using at::Tensor;

RenderMesh::RenderMesh(const Tensor& mesh_faces)
    : faces(mesh_faces.contiguous()), twins(raster::edge_twins(faces)) {}

Tensor render_mesh(const Tensor& vertices, const Tensor& rest, const RenderMesh& mesh,
                   const std::vector<scene::Camera>& cameras, const raster::SurfaceShader& shader,
                   Tensor* rast_out) {
  const auto views = static_cast<int64_t>(cameras.size());
  const int64_t height = cameras[0].height, width = cameras[0].width;
  const Tensor clip = scene::to_clip(vertices, scene::clip_matrices(cameras).to(vertices.device()));
  const Tensor rast = raster::rasterize(clip, mesh.faces, height, width);
  if (rast_out) *rast_out = rast.detach();
  // Shade covered pixels only.
  const Tensor covered = (rast.detach().select(3, 3) > 0).flatten().nonzero().flatten();
  const Tensor colors = shader(raster::surface_points(rest, rast, mesh.faces, covered));
  const Tensor picture = raster::paint_pixels(colors, covered, views * height * width)
                             .view({views, height, width, colors.size(0) + 1});
  return raster::antialias(picture, rast, clip, mesh.faces, mesh.twins);
}

}  // namespace tt3d::mesh
