#include "tt3d/lighting.h"

#include <ATen/ATen.h>

namespace tt3d::object {

using at::Tensor;

Tensor irradiance_terms(const Tensor& normals) {
  const Tensor x = normals[0], y = normals[1], z = normals[2];
  return at::stack({at::ones_like(x), x, y, z, x * y, y * z, 3 * z * z - 1, x * z, x * x - y * y});
}

Tensor irradiance(const Tensor& normals, const Tensor& lights) {
  const Tensor unit = normals / normals.norm(2, {0}, true).clamp_min(1e-12);
  return at::matmul(lights.t(), irradiance_terms(unit)).clamp_min(0);
}

Tensor lobe(const Tensor& cosine) {
  return 0.25 + 0.5 * cosine + (5.0 / 32) * (3 * cosine.square() - 1);
}

}  // namespace tt3d::object
