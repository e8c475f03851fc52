#pragma once

#include <ATen/core/Tensor.h>

#include "raw_view.h"
#include "tt3d/scene.h"

/// Resampling of images. Averages are weighted by alpha (premultiplied), so the arbitrary colour of
/// transparent pixels does not bleed into the object's edge.
namespace tt3d::capture {

/// Downscales a view so that its longer side is at most `max_size` (0: no change). Scales the
/// intrinsics too, each axis by its own ratio.
void limit_size(View& view, int max_size);

/// The image of the same camera without lens distortion (bilinear). Pixels outside the photograph
/// are transparent if `has_mask`, else they have the colour of the edge.
[[nodiscard]] at::Tensor undistort(const at::Tensor& rgba, const scene::Camera& camera,
                                   const Distortion& distortion, bool has_mask);

/// Distorted from ideal image coordinates (x/z, y/z with y down). False if the distortion model is
/// not invertible there, i.e. beyond the lens's field of view.
[[nodiscard]] bool distort(const Distortion& d, double x, double y, double& out_x, double& out_y);

}  // namespace tt3d::capture
