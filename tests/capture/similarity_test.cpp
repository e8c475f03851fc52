#include "tt3d/similarity.h"

#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include "support/shapes.h"

namespace tt3d {
namespace {

using at::Tensor;

TEST(StructuralSimilarity, EqualPicturesAndShiftedMeans) {
  const Tensor a = at::full({2, 3, 20, 24}, 0.25, at::kDouble);
  EXPECT_NEAR(structural_similarity(a, a).min().item<double>(), 1, 1e-12);
  // Without variance only the means count: (2 m n + c1) / (m^2 + n^2 + c1), c1 = 1e-4.
  const double expected = (2 * 0.25 * 0.5 + 1e-4) / (0.25 * 0.25 + 0.5 * 0.5 + 1e-4);
  EXPECT_NEAR(structural_similarity(a, 2 * a)[0].item<double>(), expected, 1e-9);
}

TEST(StructuralSimilarity, StrideTakesEverySecondWindow) {
  const Tensor a = testing::uniform({1, 3, 41, 41}, 0, 1, 1),
               b = testing::uniform({1, 3, 41, 41}, 0, 1, 2);
  EXPECT_NEAR(structural_similarity(a, b, 2)[0].item<double>(),
              structural_similarity(a, b, 1)[0].item<double>(), 0.02);
}

}  // namespace
}  // namespace tt3d
