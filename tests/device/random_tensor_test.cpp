#include "tt3d/random_tensor.h"

#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include "tt3d/core.h"

namespace tt3d {
namespace {

using at::Tensor;

TEST(RandomTensor, HoldsTheNumbersOfTheStream) {
  Random units(3, "test", 5), ranges(3, "test", 5);
  const RandomKey key = units.key();
  const Tensor a = uniform_tensor({7, 3}, key, at::kCPU).flatten();
  const Tensor b = uniform_tensor({7, 3}, -2, 5, key, at::kCPU).flatten();
  for (int64_t i = 0; i < 21; ++i) {
    EXPECT_EQ(a[i].item<float>(), units.uniform());
    EXPECT_EQ(b[i].item<float>(), static_cast<float>(ranges.uniform(-2, 5)));
  }
}

TEST(RandomTensor, NoiseIsMadeOfTheStreamsWords) {
  for (const int64_t count : {1, 6, 9001}) {
    Random words(3, "test", 5);
    const Tensor noise = noise_tensor({count}, words.key(), at::kCPU);
    for (int64_t i = 0; i < count; ++i) {
      const uint32_t a = words.next(), b = words.next();
      const double sum = (a & 0xFFFF) + (a >> 16) + (b & 0xFFFF) + (b >> 16);
      ASSERT_NEAR(noise[i].item<double>(), (sum / 65536 - 2) * 1.7320508, 1e-5);
    }
  }
}

TEST(RandomTensor, NoiseHasMeanZeroAndVarianceOne) {
  const Tensor noise = noise_tensor({200000}, Random(1, "moments").key(), at::kCPU);
  EXPECT_NEAR(noise.mean().item<double>(), 0, 0.01);
  EXPECT_NEAR(noise.var().item<double>(), 1, 0.02);
}

}  // namespace
}  // namespace tt3d
