#include "color_space.h"

#include <ATen/ATen.h>

#include "tt3d/attack.h"

namespace tt3d {

using at::Tensor;

Tensor lab_of_srgb(const Tensor& colors) {
  // IEC 61966-2-1, then CIE 15: XYZ over the white point of D65, then the cube root with its toe.
  // Each branch of a where sees only values at which its slope is finite.
  const Tensor linear = at::where(
      colors > 0.04045, ((colors.clamp_min(0.04045) + 0.055) / 1.055).pow(2.4), colors / 12.92);
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

const std::vector<std::string>& color_space_names() {
  static const std::vector<std::string> names = {"rgb", "lab"};
  return names;
}

Tensor color_distance(const std::string& space, const Tensor& a, const Tensor& b) {
  if (space == "rgb") return (a - b).square().sum();
  if (space == "lab") return ((lab_of_srgb(a) - lab_of_srgb(b)) / 100).square().sum();
  throw InputError("attack.color_space: unknown '" + space + "', expected rgb or lab");
}

}  // namespace tt3d
