#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include <cmath>

#include "capture/synthetic_capture.h"
#include "support/temporary_folder.h"
#include "tt3d/capture.h"
#include "tt3d/image.h"

namespace tt3d::capture {
namespace {

/// Largest distance of a fixture ball's surface from the origin of the normalised frame.
double reach(const Capture& capture) {
  double largest = 0;
  for (const testing::Ball& ball : testing::fixture_balls()) {
    double squared = 0;
    for (int a = 0; a < 3; ++a) {
      const double d = ball.position[a] - capture.normalization.centre[a];
      squared += d * d;
    }
    largest = std::max(largest, std::sqrt(squared) + testing::kBallRadius);
  }
  return largest * capture.normalization.scale;
}

TEST(Normalize, MaskedObjectFillsTheUnitBallWithAMargin) {
  testing::TemporaryFolder folder;
  testing::write_nerfstudio(folder.path(), testing::fixture_cameras(40));
  const Capture capture = testing::load(folder.path());
  EXPECT_LT(reach(capture), 1.0);
  EXPECT_GT(reach(capture), 0.8);
  EXPECT_DOUBLE_EQ(capture.object_radius, 0.95);
}

TEST(Normalize, WorldPositionsComeBack) {
  testing::TemporaryFolder folder;
  const auto cameras = testing::fixture_cameras(20);
  testing::write_nerf_synthetic(folder.path(), cameras, cameras);
  const Capture capture = testing::load(folder.path());
  for (size_t i = 0; i < cameras.size(); ++i) {
    const auto inside = capture.train[i].camera.position();
    for (int a = 0; a < 3; ++a) {
      EXPECT_NEAR(inside[a] / capture.normalization.scale + capture.normalization.centre[a],
                  cameras[i].position[a], 1e-9);
    }
  }
}

TEST(Normalize, ScaleOfTheWorldDoesNotMatter) {
  testing::TemporaryFolder folder, large_folder;
  auto cameras = testing::fixture_cameras(20);
  testing::write_nerfstudio(folder.path(), cameras);
  testing::write_nerfstudio(large_folder.path(), cameras);
  testing::edit_json(large_folder / "transforms.json", [](auto& root) {
    for (auto& frame : root["frames"]) {
      for (int r = 0; r < 3; ++r) {
        auto& value = frame["transform_matrix"][r][3];
        value = 1000 * value.template get<double>();
      }
    }
  });
  const Capture small = testing::load(folder.path());
  const Capture large = testing::load(large_folder.path());
  EXPECT_NEAR(large.normalization.scale * 1000, small.normalization.scale, 1e-6);
  for (size_t i = 0; i < small.train.size(); ++i) {
    for (int a = 0; a < 3; ++a) {
      EXPECT_NEAR(small.train[i].camera.position()[a], large.train[i].camera.position()[a], 1e-6);
    }
  }
}

TEST(Normalize, WithoutMasksTheCamerasDecide) {
  testing::TemporaryFolder folder;
  const auto cameras = testing::fixture_cameras(30);
  testing::write_nerfstudio(folder.path(), cameras);
  for (int i = 0; i < 30; ++i) {
    const auto path =
        folder / ("images/view_" + std::to_string(i / 10) + std::to_string(i % 10) + ".png");
    write_file_atomic(path, image::encode_png(image::read_image(path).narrow(2, 0, 3)));
  }
  const Capture capture = testing::load(folder.path());
  EXPECT_FALSE(capture.has_masks);
  EXPECT_NEAR(capture.normalization.centre[0], 1, 1e-3);
  EXPECT_NEAR(capture.normalization.centre[1], -2, 1e-3);
  EXPECT_NEAR(capture.normalization.centre[2], 3, 1e-3);
  // The ball that fills the view has a radius of about 5.5 sin(atan(45 / 150)).
  EXPECT_NEAR(0.95 / capture.normalization.scale, 5.5 * std::sin(std::atan(0.3)), 0.15);
}

}  // namespace
}  // namespace tt3d::capture
