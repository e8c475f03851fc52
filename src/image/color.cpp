#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>

#include "tt3d/image.h"

namespace tt3d::image {

using at::Tensor;

float linear_to_srgb(float value) {
  const float v = std::clamp(value, 0.F, 1.F);
  return v <= 0.0031308F ? 12.92F * v : 1.055F * std::pow(v, 1 / 2.4F) - 0.055F;
}

float srgb_to_linear(float value) {
  const float v = std::clamp(value, 0.F, 1.F);
  return v <= 0.04045F ? v / 12.92F : std::pow((v + 0.055F) / 1.055F, 2.4F);
}

// `where` differentiates both branches, so each clamps its input to values with a finite slope.
Tensor linear_to_srgb(const Tensor& linear) {
  return at::where(linear > 0.0031308, 1.055 * linear.clamp_min(0.0031308).pow(1 / 2.4) - 0.055,
                   12.92 * linear);
}

Tensor srgb_to_linear(const Tensor& srgb) {
  return at::where(srgb > 0.04045, ((srgb.clamp_min(0.04045) + 0.055) / 1.055).pow(2.4),
                   srgb / 12.92);
}

}  // namespace tt3d::image
