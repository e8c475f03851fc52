#pragma once

#include <ATen/ATen.h>

/// Slow, obvious references in plain tensor operations for the tests of the raster room.
namespace tt3d::testing {

/// The result of tt3d::rasterize: tests every pixel against every triangle after the perspective
/// division. Triangles must be wholly in front of the camera. float64.
at::Tensor reference_rasterize(const at::Tensor& clip, const at::Tensor& faces, int64_t height,
                               int64_t width);

/// Differentiable (u,v) at the pixels of a given rast [N,H,W,4], computed from clip: barycentric
/// weights in screen space, corrected for perspective. Returns [N,H,W,2].
at::Tensor reference_barycentrics(const at::Tensor& clip, const at::Tensor& rast,
                                  const at::Tensor& faces);

}  // namespace tt3d::testing
