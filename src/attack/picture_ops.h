#pragma once

#include <ATen/core/Tensor.h>

/// The transforms that have their own kernels. float32 or float64.
namespace tt3d::attack {

/// Places renderings [N,4,H,W], premultiplied, over backgrounds; returns [N,3,size,size]. `maps`
/// [N,2,3] map coordinates of the picture to coordinates of the rendering, both [-1,1] from edge to
/// edge. background [N,3,size,size] or [N,3,1,1]. Bilinear; transparent outside the rendering.
/// Differentiable in the renderings. Fastest if these are channels-last in memory.
[[nodiscard]] at::Tensor place_over(const at::Tensor& renderings, const at::Tensor& maps,
                                    const at::Tensor& background, int64_t size);

/// Renderings [N,4,H,W], premultiplied, over white: [N,3,H,W]. Differentiable. Fastest if the
/// renderings are channels-last in memory.
[[nodiscard]] at::Tensor over_white(const at::Tensor& renderings);

}  // namespace tt3d::attack
