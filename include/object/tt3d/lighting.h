#pragma once

#include <ATen/core/Tensor.h>

/// Light on a matte surface. The irradiance of a distant environment is, within a few per cent, a
/// quadratic polynomial of the normal: the first nine spherical harmonics (Ramamoorthi & Hanrahan,
/// "An efficient representation for irradiance environment maps", SIGGRAPH 2001).
namespace tt3d::object {

/// The nine terms at unit normals [3,P]: 1, x, y, z, xy, yz, 3 z^2 - 1, xz, x^2 - y^2. Returns
/// [9,P]. The constant factors of the harmonics are part of the coefficients.
[[nodiscard]] at::Tensor irradiance_terms(const at::Tensor& normals);

/// Irradiance [3,P], one colour per point, at least 0. normals [3,P] of any length but 0; lights
/// [9,3]: coefficients of irradiance_terms. Differentiable in both.
[[nodiscard]] at::Tensor irradiance(const at::Tensor& normals, const at::Tensor& lights);

/// Irradiance of one distant light in the same nine harmonics: 1/4 + c/2 + 5/32 (3 c^2 - 1), an
/// approximation of max(0, c). c: cosine of the angle between normal and light.
[[nodiscard]] at::Tensor lobe(const at::Tensor& cosine);

}  // namespace tt3d::object
