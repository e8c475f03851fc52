#include <ATen/ATen.h>

#include <cmath>

#include "tt3d/evaluate.h"
#include "tt3d/similarity.h"

namespace tt3d {

using at::Tensor;

double psnr(const Tensor& a, const Tensor& b) {
  const double mse = (a - b).square().mean().item<double>();
  return mse <= 1e-10 ? 100.0 : -10 * std::log10(mse);
}

double ssim(const Tensor& a, const Tensor& b) {
  const auto planes = [](const Tensor& t) {
    return t.to(at::kDouble).permute({2, 0, 1}).unsqueeze(0);
  };
  return structural_similarity(planes(a), planes(b)).item<double>();
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
