#include "tt3d/image.h"

#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include "support/gradient_check.h"
#include "support/shapes.h"
#include "tt3d/core.h"

namespace tt3d::image {
namespace {

using at::Tensor;

TEST(StructuralSimilarity, EqualPicturesAndShiftedMeans) {
  const Tensor a = at::full({2, 3, 20, 24}, 0.25, at::kDouble);
  EXPECT_NEAR(structural_similarity(a, a).min().item<double>(), 1, 1e-12);
  // Without variance only the means matter: (2 m n + c1) / (m^2 + n^2 + c1), c1 = 1e-4.
  const double expected = (2 * 0.25 * 0.5 + 1e-4) / (0.25 * 0.25 + 0.5 * 0.5 + 1e-4);
  EXPECT_NEAR(structural_similarity(a, 2 * a)[0].item<double>(), expected, 1e-9);
}

TEST(StructuralSimilarity, StrideTakesEverySecondWindow) {
  const Tensor a = testing::uniform({1, 3, 41, 41}, 0, 1, 1),
               b = testing::uniform({1, 3, 41, 41}, 0, 1, 2);
  EXPECT_NEAR(structural_similarity(a, b, 2)[0].item<double>(),
              structural_similarity(a, b, 1)[0].item<double>(), 0.02);
}

/// The definition in plain tensor operations: [N,C,H,W] in, [N] out.
Tensor reference_similarity(const Tensor& a, const Tensor& b, int64_t stride) {
  const Tensor line = (-(at::arange(-5, 6, a.options()).square()) / 4.5).exp();
  const Tensor window = (line.unsqueeze(1) * line / (line.sum() * line.sum())).view({1, 1, 11, 11});
  const auto smooth = [&](const Tensor& t) {
    return at::conv2d(t.reshape({-1, 1, t.size(2), t.size(3)}), window, {}, {stride, stride});
  };
  const Tensor mx = smooth(a), my = smooth(b), vx = smooth(a * a) - mx * mx;
  const Tensor vy = smooth(b * b) - my * my, cov = smooth(a * b) - mx * my;
  const Tensor map =
      (2 * mx * my + 1e-4) * (2 * cov + 9e-4) / ((mx * mx + my * my + 1e-4) * (vx + vy + 9e-4));
  return map.reshape({a.size(0), -1}).mean(1);
}

TEST(StructuralSimilarity, EqualsTheTensorReferenceAndItsGradient) {
  const Tensor b = testing::uniform({2, 3, 19, 27}, 0, 1, 4);
  const Tensor weight = testing::uniform({2}, 0.5, 1, 5);
  for (const int64_t stride : {1, 2, 3}) {
    const Tensor a = testing::uniform({2, 3, 19, 27}, 0, 1, 3).requires_grad_(true);
    const Tensor expected = a.detach().clone().requires_grad_(true);
    const Tensor value = structural_similarity(a, b, stride);
    const Tensor reference = reference_similarity(expected, b, stride);
    EXPECT_LT((value - reference).abs().max().item<double>(), 1e-12);
    (value * weight).sum().backward();
    (reference * weight).sum().backward();
    EXPECT_LT((a.grad() - expected.grad()).abs().max().item<double>(), 1e-12);
    const Tensor in_float = structural_similarity(a.to(at::kFloat), b.to(at::kFloat), stride);
    EXPECT_LT((in_float.to(at::kDouble) - value).abs().max().item<double>(), 1e-4);
  }
}

TEST(StructuralSimilarity, GradientAgainstCentralDifferences) {
  const Tensor a = testing::uniform({1, 1, 13, 14}, 0, 1, 6);
  const Tensor b = testing::uniform({1, 1, 13, 14}, 0, 1, 7);
  const auto loss = [&](const std::vector<Tensor>& in) {
    return structural_similarity(in[0], b, 2).square().sum();
  };
  EXPECT_LT(testing::gradient_error(loss, {a}, 1e-6), 1e-6);
}

}  // namespace
}  // namespace tt3d::image
