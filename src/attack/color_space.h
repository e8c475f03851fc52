#pragma once

#include <ATen/core/Tensor.h>

#include "tt3d/attack_options.h"

namespace tt3d::attack {

/// CIE L*a*b* (1976) under D65 of sRGB colours [3,P] in [0,1]: L from 0 to 100. Differentiable.
[[nodiscard]] at::Tensor lab_of_srgb(const at::Tensor& colors);

/// Squared distance of colours [3,P] in that space, summed over points and channels.
[[nodiscard]] at::Tensor color_distance(ColorSpace space, const at::Tensor& a, const at::Tensor& b);

}  // namespace tt3d::attack
