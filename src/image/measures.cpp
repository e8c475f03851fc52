#include <ATen/ATen.h>

#include <cmath>

#include "tt3d/image.h"

namespace tt3d::image {

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

}  // namespace tt3d::image
