#include <ATen/ATen.h>

#include <cmath>

#include "tt3d/mesh.h"

namespace tt3d {

using at::Tensor;

RenderMesh::RenderMesh(const Tensor& mesh_faces)
    : faces(mesh_faces.contiguous()), twins(edge_twins(faces)) {}

Tensor clip_matrices(const std::vector<Camera>& cameras, double extent) {
  Tensor matrices = at::empty({static_cast<int64_t>(cameras.size()), 4, 4});
  auto* out = matrices.mutable_data_ptr<float>();
  for (const Camera& camera : cameras) {
    const auto p = camera.position();
    const double distance = std::hypot(p[0], p[1], p[2]);
    const double near = std::max(0.01, distance - extent), far = distance + extent;
    for (const double x : world_to_clip(camera, near, far)) *out++ = static_cast<float>(x);
  }
  return matrices;
}

Tensor vertex_normals(const Tensor& vertices, const Tensor& faces) {
  const Tensor corners = faces.to(at::kLong);
  const auto corner = [&](int64_t k) { return vertices.index_select(0, corners.select(1, k)); };
  const Tensor a = corner(0);
  const Tensor across = at::cross(corner(1) - a, corner(2) - a, 1);  // twice the area long
  Tensor sum = at::zeros_like(vertices);
  for (int64_t k = 0; k < 3; ++k) sum = sum.index_add(0, corners.select(1, k), across);
  return sum / (sum.square().sum(1, true) + 1e-30).sqrt();
}

Tensor render_mesh(const Tensor& vertices, const Tensor& rest, const RenderMesh& mesh,
                   const std::vector<Camera>& cameras, const SurfaceShader& shader,
                   Tensor* rast_out) {
  const auto views = static_cast<int64_t>(cameras.size());
  const int64_t height = cameras[0].height, width = cameras[0].width;
  const Tensor clip = to_clip(vertices, clip_matrices(cameras).to(vertices.device()));
  const Tensor rast = rasterize(clip, mesh.faces, height, width);
  if (rast_out) *rast_out = rast.detach();
  // Shade covered pixels only.
  const Tensor covered = (rast.detach().select(3, 3) > 0).flatten().nonzero().flatten();
  const Tensor colors = shader(surface_points(rest, rast, mesh.faces, covered));
  const Tensor picture = paint_pixels(colors, covered, views * height * width)
                             .view({views, height, width, colors.size(0) + 1});
  return antialias(picture, rast, clip, mesh.faces, mesh.twins);
}

}  // namespace tt3d
