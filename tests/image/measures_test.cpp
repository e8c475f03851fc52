#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include "support/shapes.h"
#include "tt3d/core.h"
#include "tt3d/image.h"

namespace tt3d::image {
namespace {

using at::Tensor;

TEST(Measures, PsnrOfAKnownError) {
  const Tensor a = at::zeros({8, 8, 3}), b = at::full({8, 8, 3}, 0.1F);
  EXPECT_NEAR(psnr(a, b), 20, 1e-5);
  EXPECT_EQ(psnr(a, a), 100);
}

TEST(Measures, SsimOfEqualConstantAndInvertedPictures) {
  const Tensor a = testing::uniform({24, 24, 3}, 0, 1, 1).to(at::kFloat);
  EXPECT_NEAR(ssim(a, a), 1, 1e-9);
  EXPECT_LT(ssim(a, 1 - a), 0);
  // Constant pictures: only the luminance term is left, (2ab + c1) / (a^2 + b^2 + c1).
  const Tensor x = at::full({16, 16, 1}, 0.4F), y = at::full({16, 16, 1}, 0.6F);
  EXPECT_NEAR(ssim(x, y), (2 * 0.24 + 1e-4) / (0.16 + 0.36 + 1e-4), 1e-6);
}

TEST(AveragePixels, InLinearLightAndByCover) {
  // Black and white beside each other are half the light: sRGB 0.735, not 0.5.
  Tensor picture = at::ones({1, 2, 4, 4});
  picture.slice(2, 0, 1).narrow(3, 0, 3).zero_();
  // The right half: a white pixel, the other three see nothing.
  picture.slice(2, 2, 4).zero_();
  picture[0][0][2].fill_(1);
  const Tensor mean = average_pixels(picture, 2);
  ASSERT_EQ(mean.sizes(), at::IntArrayRef({1, 1, 2, 4}));
  EXPECT_NEAR(mean[0][0][0][0].item<double>(), 0.735357, 1e-5);
  EXPECT_NEAR(mean[0][0][0][3].item<double>(), 1, 1e-6);
  EXPECT_NEAR(mean[0][0][1][1].item<double>(), 0.25, 1e-5);  // white, premultiplied
  EXPECT_NEAR(mean[0][0][1][3].item<double>(), 0.25, 1e-6);
  const Tensor flat = at::cat({at::full({1, 9, 9, 3}, 0.02F), at::ones({1, 9, 9, 1})}, 3);
  EXPECT_TRUE(at::allclose(average_pixels(flat, 3), flat.slice(1, 0, 3).slice(2, 0, 3), 1e-4));
}

}  // namespace
}  // namespace tt3d::image
