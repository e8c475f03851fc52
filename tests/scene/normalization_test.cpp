#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include "tt3d/core.h"
#include "tt3d/scene.h"

namespace tt3d::scene {
namespace {

// The centre is far from 0 and the scale is not a power of two: a wrong sign or a wrong order of
// the two steps would change the result.
const Normalization kPlaced = {0.92, {3, -2, 0.5}};

TEST(Normalization, PointsGoThereAndBack) {
  const at::Tensor world = at::tensor({3.F, -2.F, 0.5F, 4.F, -2.F, 1.5F}).view({2, 3});
  const at::Tensor inside = kPlaced.to_inside(world);
  EXPECT_TRUE(at::allclose(inside[0], at::zeros({3})));
  EXPECT_TRUE(at::allclose(inside[1], at::tensor({0.92F, 0.F, 0.92F})));
  EXPECT_TRUE(at::allclose(kPlaced.to_world(inside), world));
}

TEST(Normalization, CamerasAndFramesGoAlong) {
  const SampledView inside = orbit_view({{0, 0, 0}, 1, 4, 40}, 30, 20, 64);
  const Camera world = kPlaced.to_world(inside.camera);
  // The same pixel shows a point of the object in both frames.
  const at::Tensor point = at::tensor({0.2F, -0.3F, 0.4F}).view({1, 3});
  const PixelBox a = object_box(inside.camera, point);
  const PixelBox b = object_box(world, kPlaced.to_world(point));
  EXPECT_EQ(a.left, b.left);
  EXPECT_EQ(a.top, b.top);
  const Camera back = kPlaced.to_inside(world);
  for (size_t i = 0; i < 16; ++i) {
    EXPECT_NEAR(back.camera_to_world[i], inside.camera.camera_to_world[i], 1e-12);
  }
  const ViewFrame frame = kPlaced.to_world(ViewFrame{{0.92, 0, 0}, 0.92, 1.84, 40});
  EXPECT_NEAR(frame.centre[0], 4, 1e-12);
  EXPECT_NEAR(frame.radius, 1, 1e-12);
  EXPECT_NEAR(frame.distance, 2, 1e-12);
}

TEST(Normalization, ATurnedWorldStandsUprightInsideAndKeepsItsViews) {
  const Normalization turned = {0.92, {3, -2, 0.5}, {0.6, 0, 0.8}};
  const at::Tensor world = at::tensor({3.6F, -2.F, 1.3F, 1.F, 7.F, -4.F}).view({2, 3});
  const at::Tensor inside = turned.to_inside(world);
  EXPECT_TRUE(at::allclose(inside[0], at::tensor({0.F, 0.F, 0.92F}), 1e-5, 1e-6));
  EXPECT_TRUE(at::allclose(turned.to_world(inside), world, 1e-5, 1e-5));
  const ViewFrame frame = {{0.1, 0.2, 0}, 1, 4, 40};
  const Camera expected = orbit_view(frame, 30, 20, 64).camera;
  const Camera camera = orbit_view(turned.to_world(frame), 30, 20, 64).camera;
  const Camera back = turned.to_inside(camera);
  const Camera there = turned.to_world(expected);
  for (size_t i = 0; i < 16; ++i) {
    EXPECT_NEAR(back.camera_to_world[i], expected.camera_to_world[i], 1e-9);
    EXPECT_NEAR(there.camera_to_world[i], camera.camera_to_world[i], 1e-9);
  }
}

}  // namespace
}  // namespace tt3d::scene
