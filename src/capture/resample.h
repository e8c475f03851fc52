#pragma once

#include <ATen/core/Tensor.h>

#include "raw_view.h"

/// Changes of an image's pixel grid. Colours are averaged weighted by alpha (premultiplied), so
/// the arbitrary colour behind transparent pixels never bleeds into the object's edge.
namespace tt3d {

/// Area average of [H,W,4] uint8 straight alpha to `width` x `height` pixels, neither larger than
/// before. Pixels that end up wholly transparent are black.
[[nodiscard]] at::Tensor downscale(const at::Tensor& rgba, int width, int height);

/// Downscales a view so that its longer side is at most `max_size` (0: leaves it) and scales its
/// intrinsics, each axis by its own ratio.
void limit_size(View& view, int max_size);

/// The image as the same pinhole camera without distortion would have taken it (bilinear). Where
/// the photograph has no pixel the result is transparent if `has_mask`, else the edge's colour.
[[nodiscard]] at::Tensor undistort(const at::Tensor& rgba, const Camera& camera,
                                   const Distortion& distortion, bool has_mask);

/// Distorted from ideal image coordinates (x/z, y/z with y down). False where the model folds
/// over, beyond the lens's field of view.
[[nodiscard]] bool distort(const Distortion& d, double x, double y, double& out_x, double& out_y);

}  // namespace tt3d
