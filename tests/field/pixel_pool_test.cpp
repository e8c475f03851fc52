#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include <array>
#include <set>

#include "rays.h"
#include "support/synthetic_capture.h"
#include "tt3d/image.h"

namespace tt3d::field {
namespace {

using at::Tensor;
using Pixel = std::array<float, 4>;

std::set<Pixel> pixels_of(const Tensor& rows) {
  std::set<Pixel> pixels;
  const Tensor flat = rows.reshape({-1, 4}).contiguous();
  const auto* p = flat.const_data_ptr<float>();
  for (int64_t i = 0; i < flat.size(0); ++i, p += 4) pixels.insert({p[0], p[1], p[2], p[3]});
  return pixels;
}

TEST(PixelPool, EightBitPhotographsGiveTheBytesOfPremultiplied) {
  const capture::Capture capture = testing::ball_capture(8, 48);
  const PixelPool pool = make_pixel_pool(capture.train, 32, at::kCPU);
  EXPECT_EQ(pool.pictures.scalar_type(), at::kByte);
  std::set<Pixel> expected;
  for (const capture::View& view : capture.train) {
    expected.merge(pixels_of(image::premultiplied(view.rgba)));
  }
  const std::set<Pixel> drawn = pixels_of(random_rays(pool, 20000, 1, 0).targets);
  EXPECT_GT(drawn.size(), 1000U);
  for (const Pixel& pixel : drawn) EXPECT_TRUE(expected.contains(pixel));
}

}  // namespace
}  // namespace tt3d::field
