#include "tt3d/surface.h"

#include <ATen/ATen.h>

namespace tt3d::scene {

using at::Tensor;

TriMesh TriMesh::to(at::Device device) const {
  return {vertices.detach().to(device), faces.to(device)};
}

UvMap UvMap::to(at::Device device) const { return {uvs.to(device), faces.to(device)}; }

Tensor vertex_normals(const Tensor& vertices, const Tensor& faces) {
  const Tensor corners = faces.to(at::kLong);
  const auto corner = [&](int64_t k) { return vertices.index_select(0, corners.select(1, k)); };
  const Tensor a = corner(0);
  const Tensor across = at::cross(corner(1) - a, corner(2) - a, 1);  // length: twice the area
  Tensor sum = at::zeros_like(vertices);
  for (int64_t k = 0; k < 3; ++k) sum = sum.index_add(0, corners.select(1, k), across);
  return sum / (sum.square().sum(1, true) + 1e-30).sqrt();
}

}  // namespace tt3d::scene
