#pragma once

#include <ATen/core/Tensor.h>

/// Operators of the transforms that are worth kernels of their own. float32 or float64.
namespace tt3d {

/// Renderings [N,4,H,W], premultiplied, placed over backgrounds: [N,3,size,size]. `maps` [N,2,3]
/// lead from the picture's coordinates to the rendering's, both [-1,1] from edge to edge;
/// background [N,3,size,size] or [N,3,1,1]. Bilinear, transparent outside the rendering.
/// Differentiable in the renderings. Fastest where these lie in memory channel by channel.
[[nodiscard]] at::Tensor place_over(const at::Tensor& renderings, const at::Tensor& maps,
                                    const at::Tensor& background, int64_t size);

/// Renderings [N,4,H,W], premultiplied, over white: [N,3,H,W]. Differentiable. Likewise.
[[nodiscard]] at::Tensor over_white(const at::Tensor& renderings);

/// Gaussian blur of pictures [N,C,H,W], sigma in pixels; the kernel ends at two sigma, and the
/// border's pixels go on outside. Differentiable.
[[nodiscard]] at::Tensor gaussian_blur(const at::Tensor& pictures, double sigma);

}  // namespace tt3d
