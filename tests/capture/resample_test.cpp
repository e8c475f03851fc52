#include "capture/resample.h"
#include "tt3d/capture.h"
#include "tt3d/image.h"
#include "tt3d/scene.h"

#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include <cmath>

namespace tt3d::capture {
namespace {

TEST(Downscale, TransparentColourDoesNotBleed) {
  // Left half opaque blue, right half transparent pink; the middle of the three columns mixes both.
  at::Tensor image = at::zeros({4, 6, 4}, at::kByte);
  image.narrow(1, 0, 3).copy_(at::tensor({0, 0, 200, 255}).to(at::kByte));
  image.narrow(1, 3, 3).copy_(at::tensor({255, 0, 200, 0}).to(at::kByte));
  const at::Tensor small = image::downscale(image, 3, 2);
  const at::Tensor expected =
      at::tensor({0, 0, 200, 255, 0, 0, 200, 128, 0, 0, 0, 0}).to(at::kByte).view({1, 3, 4});
  EXPECT_TRUE(at::equal(small, expected.expand({2, 3, 4}))) << small;
}

TEST(Downscale, FractionalRatioIsAnAreaAverage) {
  // 3 columns to 2: each target covers one and a half source pixels.
  at::Tensor image = at::full({1, 3, 4}, 255, at::kByte);
  image.select(2, 0).copy_(at::tensor({30, 60, 90}).to(at::kByte).view({1, 3}));
  const at::Tensor small = image::downscale(image, 2, 1);
  EXPECT_EQ(small[0][0][0].item<uint8_t>(), 40);
  EXPECT_EQ(small[0][1][0].item<uint8_t>(), 80);
}

TEST(LimitSize, ScalesIntrinsicsWithEachAxis) {
  View view;
  view.rgba = at::zeros({50, 101, 4}, at::kByte);
  view.camera.width = 101;
  view.camera.height = 50;
  view.camera.fx = view.camera.fy = 200;
  view.camera.cx = 50.5;
  view.camera.cy = 20;
  limit_size(view, 40);
  EXPECT_EQ(view.camera.width, 40);
  EXPECT_EQ(view.camera.height, 20);
  EXPECT_EQ(view.rgba.size(1), 40);
  EXPECT_DOUBLE_EQ(view.camera.cx, 20);
  EXPECT_DOUBLE_EQ(view.camera.fx, 200 * 40 / 101.0);
  EXPECT_DOUBLE_EQ(view.camera.fy, 80);
  limit_size(view, 64);
  EXPECT_EQ(view.camera.width, 40);  // never enlarged
}

scene::Camera test_camera() {
  scene::Camera camera;
  camera.width = 160;
  camera.height = 120;
  camera.fx = camera.fy = 140;
  camera.cx = 77;
  camera.cy = 63;
  return camera;
}

/// The picture of the ideal camera: colours vary smoothly with the direction.
std::array<double, 3> scene(double x, double y) {
  return {128 + 100 * std::sin(4 * x), 128 + 100 * std::sin(5 * y),
          128 + 90 * std::sin(3 * (x - y))};
}

/// Inverse of the lens model by fixed-point iteration, as in OpenCV.
std::array<double, 2> ideal_of(const Distortion& d, double xd, double yd) {
  double x = xd, y = yd;
  for (int i = 0; i < 60; ++i) {
    const double r2 = x * x + y * y;
    const double radial = 1 + d.k1 * r2 + d.k2 * r2 * r2;
    const double dx = 2 * d.p1 * x * y + d.p2 * (r2 + 2 * x * x);
    const double dy = d.p1 * (r2 + 2 * y * y) + 2 * d.p2 * x * y;
    x = (xd - dx) / radial;
    y = (yd - dy) / radial;
  }
  return {x, y};
}

TEST(Undistort, GivesThePictureOfTheIdealCamera) {
  const scene::Camera camera = test_camera();
  const Distortion lens = {0.15, -0.05, 0.006, -0.004};
  at::Tensor photo = at::full({camera.height, camera.width, 4}, 255, at::kByte);
  auto pixels = photo.accessor<uint8_t, 3>();
  for (int r = 0; r < camera.height; ++r) {
    for (int c = 0; c < camera.width; ++c) {
      const auto [x, y] =
          ideal_of(lens, (c + 0.5 - camera.cx) / camera.fx, (r + 0.5 - camera.cy) / camera.fy);
      const auto colour = scene(x, y);
      for (int k = 0; k < 3; ++k) pixels[r][c][k] = static_cast<uint8_t>(std::lround(colour[k]));
    }
  }
  const at::Tensor result = undistort(photo, camera, lens, true);
  const auto out = result.accessor<uint8_t, 3>();
  int compared = 0;
  for (int r = 0; r < camera.height; ++r) {
    for (int c = 0; c < camera.width; ++c) {
      if (out[r][c][3] < 255) continue;
      ++compared;
      const auto colour =
          scene((c + 0.5 - camera.cx) / camera.fx, (r + 0.5 - camera.cy) / camera.fy);
      for (int k = 0; k < 3; ++k) ASSERT_NEAR(out[r][c][k], colour[k], 2) << r << " " << c;
    }
  }
  EXPECT_GT(compared, camera.width * camera.height * 8 / 10);
}

TEST(Undistort, BeyondThePhotographIsTransparentOrTheEdge) {
  const scene::Camera camera = test_camera();
  const Distortion pincushion = {0.5, 0, 0, 0};  // the ideal picture is larger than the photograph
  const at::Tensor photo = at::full({camera.height, camera.width, 4}, 255, at::kByte);
  EXPECT_EQ(undistort(photo, camera, pincushion, true)[0][0][3].item<uint8_t>(), 0);
  EXPECT_EQ(undistort(photo, camera, pincushion, false)[0][0][3].item<uint8_t>(), 255);
}

TEST(Undistort, FoldedLensModelIsNotFollowed) {
  double x = 0, y = 0;
  EXPECT_TRUE(distort({-0.3, 0, 0, 0}, 0.5, 0, x, y));
  EXPECT_FALSE(distort({-0.3, 0, 0, 0}, 1.5, 0, x, y));
}

}  // namespace
}  // namespace tt3d::capture
