#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>

namespace tt3d {

/// Structural similarity (Wang et al. 2004) of pictures in [0,1]: Gaussian window of sigma 1.5 over
/// 11 pixels, mean over colours and over the windows that lie inside, every `stride`-th each way.
/// a, b [N,C,H,W], floating, at least 11 pixels a side; returns [N]. Differentiable in a.
[[nodiscard]] at::Tensor structural_similarity(const at::Tensor& a, const at::Tensor& b,
                                               int64_t stride = 1);

}  // namespace tt3d
