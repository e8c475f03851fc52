#pragma once

#include <ATen/core/Tensor.h>

/// Light on a matte surface. Irradiance of any distant environment is, within some per cent, a
/// quadratic polynomial of the normal: the first nine spherical harmonics (Ramamoorthi & Hanrahan,
/// "An efficient representation for irradiance environment maps", SIGGRAPH 2001).
namespace tt3d {

/// The nine terms at unit normals [3,P]: 1, x, y, z, xy, yz, 3 z^2 - 1, xz, x^2 - y^2. Returns
/// [9,P]. The factors of the harmonics are left to the coefficients.
[[nodiscard]] at::Tensor irradiance_terms(const at::Tensor& normals);

/// Irradiance [3,P], a colour a point and at least 0, at normals [3,P] of any length but 0, of an
/// environment with coefficients lights [9,3] of irradiance_terms. Differentiable in both.
[[nodiscard]] at::Tensor irradiance(const at::Tensor& normals, const at::Tensor& lights);

/// What one distant light gives a matte surface whose normal makes the cosine c with it, by the
/// same nine harmonics: 1/4 + c/2 + 5/32 (3 c^2 - 1), in place of max(0, c).
[[nodiscard]] at::Tensor lobe(const at::Tensor& cosine);

}  // namespace tt3d
