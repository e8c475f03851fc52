#pragma once

#include <ATen/core/Tensor.h>

#include <string>

namespace tt3d {

/// CIE L*a*b* (1976) under D65 of sRGB colours [3,P] in [0,1]: L from 0 to 100. Differentiable.
[[nodiscard]] at::Tensor lab_of_srgb(const at::Tensor& colors);

/// Squared distance of colours [3,P] summed over points and channels, in the space of that name:
/// one of color_space_names. Throws InputError.
[[nodiscard]] at::Tensor color_distance(const std::string& space, const at::Tensor& a,
                                        const at::Tensor& b);

}  // namespace tt3d
