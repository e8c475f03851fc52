#include "tt3d/similarity.h"

#include <ATen/ATen.h>

namespace tt3d {

using at::Tensor;

Tensor structural_similarity(const Tensor& a, const Tensor& b, int64_t stride) {
  constexpr double kC1 = 0.01 * 0.01, kC2 = 0.03 * 0.03, kSigma = 1.5;
  constexpr int64_t kRadius = 5;
  const Tensor offsets = at::arange(-kRadius, kRadius + 1, a.options());
  Tensor kernel = (-(offsets.square()) / (2 * kSigma * kSigma)).exp();
  kernel = kernel / kernel.sum();
  const int64_t n = a.size(0), height = a.size(2), width = a.size(3);
  // All that is smoothed in one batch, a channel an item: 5 x [N*C,1,H,W].
  const Tensor x = a.reshape({-1, 1, height, width}), y = b.reshape({-1, 1, height, width});
  const Tensor all = at::cat({x, y, x * x, y * y, x * y});
  const Tensor rows = at::conv2d(all, kernel.view({1, 1, 1, -1}), {}, {1, stride});
  const Tensor smooth = at::conv2d(rows, kernel.view({1, 1, -1, 1}), {}, {stride, 1});
  const auto parts = smooth.chunk(5);
  const Tensor &mx = parts[0], &my = parts[1];
  const Tensor vx = parts[2] - mx * mx, vy = parts[3] - my * my, cov = parts[4] - mx * my;
  const Tensor map =
      ((2 * mx * my + kC1) * (2 * cov + kC2)) / ((mx * mx + my * my + kC1) * (vx + vy + kC2));
  return map.reshape({n, -1}).mean(1);
}

}  // namespace tt3d
