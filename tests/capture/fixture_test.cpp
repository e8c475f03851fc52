#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "capture/synthetic_capture.h"
#include "support/temporary_folder.h"
#include "tt3d/capture.h"
#include "tt3d/image.h"
#include "tt3d/scene.h"

// Camera conventions. For every format, a point of the input's world, normalised and projected with
// world_to_clip, must land on the pixels that show it.

namespace tt3d::capture {
namespace {

using testing::FixtureCamera;

/// Column, row and depth (in the input's units) of a point of the input's world, computed with the
/// public functions.
std::array<double, 3> pixel_of(const Capture& capture, const scene::Camera& camera,
                               const testing::Vec3& point) {
  const std::array<double, 16> clip = scene::world_to_clip(camera, 0.1, 100);
  double inside[4] = {0, 0, 0, 1};
  for (int a = 0; a < 3; ++a) {
    inside[a] = capture.normalization.scale * (point[a] - capture.normalization.centre[a]);
  }
  double out[4] = {};
  for (int r = 0; r < 4; ++r) {
    for (int c = 0; c < 4; ++c) out[r] += clip[4 * r + c] * inside[c];
  }
  EXPECT_GT(out[3], 0);
  EXPECT_LT(std::abs(out[2]), out[3]);
  return {(out[0] / out[3] + 1) / 2 * camera.width, (1 - out[1] / out[3]) / 2 * camera.height,
          out[3] / capture.normalization.scale};
}

/// Mean column and row of the pixels of one colour, and how many there are.
std::array<double, 3> centroid(const at::Tensor& rgba, const std::array<uint8_t, 3>& colour) {
  std::array<double, 3> sum{};
  const auto pixels = rgba.accessor<uint8_t, 3>();
  for (int r = 0; r < rgba.size(0); ++r) {
    for (int c = 0; c < rgba.size(1); ++c) {
      const auto p = pixels[r][c];
      const bool same = std::abs(p[0] - colour[0]) < 12 && std::abs(p[1] - colour[1]) < 12 &&
                        std::abs(p[2] - colour[2]) < 12 && p[3] > 127;
      if (!same) continue;
      sum[0] += c + 0.5;
      sum[1] += r + 0.5;
      sum[2] += 1;
    }
  }
  if (sum[2] > 0) sum[0] /= sum[2], sum[1] /= sum[2];
  return sum;
}

/// Every ball must be where the loaded camera projects it, in all views where no other ball covers
/// it.
void expect_balls_in_place(const Capture& capture) {
  int found = 0;
  int looked = 0;
  for (const std::vector<View>* views : {&capture.train, &capture.test}) {
    for (const View& view : *views) {
      for (const testing::Ball& ball : testing::fixture_balls()) {
        const auto [u, v, depth] = pixel_of(capture, view.camera, ball.position);
        const auto [x, y, count] = centroid(view.rgba, ball.colour);
        const double radius = testing::kBallRadius / depth;
        ++looked;
        // Another ball covers a part of it, so its centroid is not its centre.
        if (count < 0.94 * std::numbers::pi * radius * radius * view.camera.fx * view.camera.fy) {
          continue;
        }
        ++found;
        EXPECT_NEAR(x, u, 0.4) << view.name;
        EXPECT_NEAR(y, v, 0.4) << view.name;
      }
    }
  }
  EXPECT_GT(found, 0.6 * looked);
}

/// Cameras with two image sizes, a principal point off the centre, and lens distortion.
std::vector<FixtureCamera> mixed_cameras() {
  std::vector<FixtureCamera> cameras = testing::fixture_cameras(20);
  for (size_t i = 0; i < cameras.size(); ++i) {
    FixtureCamera& c = cameras[i];
    c.cx = 66;
    c.cy = 40;
    c.distortion = {0.08, -0.03, 0.004, -0.006};
    if (i % 3 == 0) {
      c.width = 160;
      c.height = 130;
      c.fx = 180;
      c.fy = 176;
      c.cx = 75;
      c.cy = 68;
    }
  }
  return cameras;
}

TEST(Fixture, NerfSynthetic) {
  testing::TemporaryFolder folder;
  const auto cameras = testing::fixture_cameras(20);
  testing::write_nerf_synthetic(folder.path(), {cameras.begin(), cameras.begin() + 15},
                                {cameras.begin() + 15, cameras.end()});
  const Capture capture = testing::load(folder.path());
  EXPECT_EQ(capture.format, CaptureFormat::kNerfSynthetic);
  EXPECT_EQ(capture.train.size(), 15U);
  EXPECT_EQ(capture.test.size(), 5U);
  EXPECT_EQ(capture.files.size(), 22U) << "two camera files and twenty pictures";
  EXPECT_TRUE(capture.has_masks);
  EXPECT_EQ(capture.train[0].name, "train/view_00.png");
  expect_balls_in_place(capture);
}

TEST(Fixture, Nerfstudio) {
  testing::TemporaryFolder folder;
  testing::write_nerfstudio(folder.path(), mixed_cameras());
  const Capture capture = testing::load(folder.path());
  EXPECT_EQ(capture.format, CaptureFormat::kNerfstudio);
  EXPECT_EQ(capture.test.size(), 3U);  // views 0, 8 and 16
  EXPECT_EQ(capture.test[1].name, "images/view_08.png");
  EXPECT_EQ(capture.train.size(), 17U);
  expect_balls_in_place(capture);
}

TEST(Fixture, NerfstudioNamesItsTestViews) {
  testing::TemporaryFolder folder;
  testing::write_nerfstudio(folder.path(), mixed_cameras());
  testing::edit_json(folder / "transforms.json", [](auto& root) {
    root["test_filenames"] = {"./images/view_03.png", "images/view_05.png"};
  });
  const Capture capture = testing::load(folder.path());
  ASSERT_EQ(capture.test.size(), 2U);
  EXPECT_EQ(capture.test[0].name, "images/view_03.png");
}

TEST(Fixture, ColmapText) {
  testing::TemporaryFolder folder;
  testing::write_colmap_text(folder.path(), mixed_cameras());
  const Capture capture = testing::load(folder.path());
  EXPECT_EQ(capture.format, CaptureFormat::kColmap);
  expect_balls_in_place(capture);
}

TEST(Fixture, ColmapBinaryIsTheSameAsText) {
  testing::TemporaryFolder text_folder, binary_folder;
  testing::write_colmap_text(text_folder.path(), mixed_cameras());
  testing::write_colmap_binary(binary_folder.path(), mixed_cameras());
  const Capture text = testing::load(text_folder.path());
  const Capture binary = testing::load(binary_folder.path());
  expect_balls_in_place(binary);
  ASSERT_EQ(text.train.size(), binary.train.size());
  EXPECT_DOUBLE_EQ(text.normalization.scale, binary.normalization.scale);
  for (size_t i = 0; i < text.train.size(); ++i) {
    EXPECT_EQ(text.train[i].name, binary.train[i].name);
    EXPECT_EQ(text.train[i].camera.camera_to_world, binary.train[i].camera.camera_to_world);
    EXPECT_TRUE(at::equal(text.train[i].rgba, binary.train[i].rgba));
  }
}

TEST(Fixture, ShrunkImagesKeepTheirCameras) {
  testing::TemporaryFolder folder;
  testing::write_nerfstudio(folder.path(), mixed_cameras());
  CaptureOptions options;
  options.path = folder.path();
  options.max_size = 90;
  options.max_train_views = 10;
  options.max_test_views = 2;
  Progress progress;
  const Capture capture = load_capture(options, progress);
  EXPECT_EQ(capture.train.size(), 10U);
  EXPECT_EQ(capture.test.size(), 2U);
  for (const View& view : capture.train) EXPECT_EQ(view.camera.width, 90);
  expect_balls_in_place(capture);
}

TEST(Fixture, MaskFilesInsteadOfAlpha) {
  testing::TemporaryFolder folder;
  testing::write_nerfstudio(folder.path(), mixed_cameras());
  const Capture with_alpha = testing::load(folder.path());
  for (int i = 0; i < 20; ++i) {
    const std::string name = "view_" + std::to_string(i / 10) + std::to_string(i % 10) + ".png";
    const at::Tensor rgba = image::read_image(folder / ("images/" + name));
    write_file_atomic(folder / ("images/" + name), image::encode_png(rgba.narrow(2, 0, 3)));
    write_file_atomic(folder / ("cut/" + name), image::encode_png(rgba.narrow(2, 3, 1)));
  }
  testing::edit_json(folder / "transforms.json", [](auto& root) {
    for (auto& frame : root["frames"]) {
      frame["mask_path"] = "cut/" + frame["file_path"].template get<std::string>().substr(7);
    }
  });
  const Capture with_files = testing::load(folder.path());
  EXPECT_TRUE(with_files.has_masks);
  for (size_t i = 0; i < with_files.train.size(); ++i) {
    EXPECT_TRUE(at::equal(with_files.train[i].rgba, with_alpha.train[i].rgba));
  }
}

TEST(Fixture, SharedChicken) {
  const std::filesystem::path path =
      std::filesystem::path(TT3D_SOURCE_DIR) / "../shared/data/captures/chicken";
  if (!std::filesystem::exists(path)) GTEST_SKIP() << "no " << path << " on this machine";
  CaptureOptions options;
  options.path = path;
  options.max_size = 100;
  Progress progress;
  const Capture capture = load_capture(options, progress);
  EXPECT_EQ(capture.train.size(), 100U);
  EXPECT_EQ(capture.test.size(), 100U);
  EXPECT_TRUE(capture.has_masks);
  // The object is inside the unit sphere around the origin.
  EXPECT_NEAR(capture.normalization.scale, 0.95, 0.06);
  for (const double c : capture.normalization.centre) EXPECT_NEAR(c, 0, 0.05);
  const scene::ViewFrame frame = capture_view_frame(capture);
  EXPECT_NEAR(frame.fov_y_deg, 39.6, 0.1);
  EXPECT_GT(frame.distance, 2.5);
}

}  // namespace
}  // namespace tt3d::capture
