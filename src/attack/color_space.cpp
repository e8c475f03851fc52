#include "color_space.h"

#include <ATen/ATen.h>

#include "tt3d/image.h"

namespace tt3d::attack {

using at::Tensor;

Tensor lab_of_srgb(const Tensor& colors) {
  // CIE 15: XYZ divided by the white point of D65, then the cube root, linear near 0. Each branch
  // of `where` gets only values at which its slope is finite.
  const Tensor linear = image::srgb_to_linear(colors);
  const Tensor to_xyz = at::tensor({0.4124564 / 0.95047, 0.3575761 / 0.95047, 0.1804375 / 0.95047,
                                    0.2126729, 0.7151522, 0.0721750,  //
                                    0.0193339 / 1.08883, 0.1191920 / 1.08883, 0.9503041 / 1.08883},
                                   colors.options())
                            .view({3, 3});
  const Tensor t = at::matmul(to_xyz, linear);
  constexpr double kDelta = 6.0 / 29;
  const double toe = kDelta * kDelta * kDelta;
  const Tensor f =
      at::where(t > toe, t.clamp_min(toe).pow(1.0 / 3), t / (3 * kDelta * kDelta) + 4.0 / 29);
  return at::stack({116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])});
}

Tensor color_distance(ColorSpace space, const Tensor& a, const Tensor& b) {
  if (space == ColorSpace::kRgb) return (a - b).square().sum();
  return ((lab_of_srgb(a) - lab_of_srgb(b)) / 100).square().sum();
}

}  // namespace tt3d::attack
