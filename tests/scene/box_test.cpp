#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include "support/gradient_check.h"
#include "tt3d/core.h"
#include "tt3d/scene.h"

namespace tt3d::scene {
namespace {

using at::Tensor;

/// 100 pixels a side, at the origin, looking along -z.
Camera front_camera() {
  Camera camera;
  camera.camera_to_world = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
  camera.fx = camera.fy = 100;
  camera.cx = camera.cy = 50;
  camera.width = camera.height = 100;
  return camera;
}

void expect_box(const PixelBox& box, int64_t left, int64_t top, int64_t right, int64_t bottom) {
  EXPECT_EQ(box.left, left);
  EXPECT_EQ(box.top, top);
  EXPECT_EQ(box.right, right);
  EXPECT_EQ(box.bottom, bottom);
}

TEST(ObjectBox, AroundTheProjections) {
  const Tensor corners = at::tensor({-1.0, -0.5, -4.0, 1.0, 1.0, -4.0}).view({2, 3});
  expect_box(object_box(front_camera(), corners), 25, 25, 75,
             63);  // y up: 50 - 25 to 50 + 12.5
}

TEST(ObjectBox, SmallOutsideAndBehind) {
  const Tensor speck = at::tensor({0.0, 0.0, -100.0}).view({1, 3});
  const PixelBox box = object_box(front_camera(), speck);
  EXPECT_EQ(box.right - box.left, 11);
  EXPECT_EQ(box.bottom - box.top, 11);
  EXPECT_TRUE(box.left <= 50 && box.right > 50);
  const Tensor left_of_it = at::tensor({-50.0, 0.0, -4.0}).view({1, 3});
  EXPECT_EQ(object_box(front_camera(), left_of_it).left, 0);
  EXPECT_EQ(object_box(front_camera(), left_of_it).right, 11);
  const Tensor behind = at::tensor({0.0, 0.0, -4.0, 0.0, 0.0, 1.0}).view({2, 3});
  expect_box(object_box(front_camera(), behind), 0, 0, 100, 100);
}

}  // namespace
}  // namespace tt3d::scene
