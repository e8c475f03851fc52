#include <ATen/ATen.h>

#include <cmath>

#include "tt3d/evaluate.h"

namespace tt3d {

using at::Tensor;

double psnr(const Tensor& a, const Tensor& b) {
  const double mse = (a - b).square().mean().item<double>();
  return mse <= 1e-10 ? 100.0 : -10 * std::log10(mse);
}

double ssim(const Tensor& a, const Tensor& b) {
  constexpr double kC1 = 0.01 * 0.01, kC2 = 0.03 * 0.03, kSigma = 1.5;
  constexpr int64_t kRadius = 5;
  const Tensor offsets = at::arange(-kRadius, kRadius + 1).to(at::kDouble);
  Tensor kernel = (-(offsets.square()) / (2 * kSigma * kSigma)).exp();
  kernel = (kernel / kernel.sum()).to(a.device());
  const auto smooth = [&](const Tensor& x) {
    return at::conv2d(at::conv2d(x, kernel.view({1, 1, 1, -1})), kernel.view({1, 1, -1, 1}));
  };
  // Channels as a batch: [C,1,H,W].
  const Tensor x = a.to(at::kDouble).permute({2, 0, 1}).unsqueeze(1);
  const Tensor y = b.to(at::kDouble).permute({2, 0, 1}).unsqueeze(1);
  const Tensor mx = smooth(x), my = smooth(y);
  const Tensor vx = smooth(x * x) - mx * mx, vy = smooth(y * y) - my * my;
  const Tensor cov = smooth(x * y) - mx * my;
  const Tensor map =
      ((2 * mx * my + kC1) * (2 * cov + kC2)) / ((mx * mx + my * my + kC1) * (vx + vy + kC2));
  return map.mean().item<double>();
}

Interval wilson_interval(int64_t successes, int64_t n) {
  if (n == 0) return {0, 1};
  constexpr double z = 1.959963984540054;
  const auto count = static_cast<double>(n);
  const double p = static_cast<double>(successes) / count;
  const double denominator = 1 + z * z / count;
  const double middle = (p + z * z / (2 * count)) / denominator;
  const double half =
      z * std::sqrt(p * (1 - p) / count + z * z / (4 * count * count)) / denominator;
  return {std::max(0.0, middle - half), std::min(1.0, middle + half)};
}

}  // namespace tt3d
