#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include "tt3d/core.h"
#include "tt3d/scene.h"

namespace tt3d::scene {
namespace {

ViewFrame off_centre_frame() {
  ViewFrame frame;
  frame.centre = {1, 2, -1};
  frame.radius = 0.9;
  frame.distance = 3;
  frame.fov_y_deg = 40;
  return frame;
}

std::vector<double> field(const std::vector<SampledView>& views, double SampledView::*member) {
  std::vector<double> values;
  for (const SampledView& view : views) values.push_back(view.*member);
  return values;
}

double mean(const std::vector<double>& values) {
  double sum = 0;
  for (const double v : values) sum += v;
  return sum / static_cast<double>(values.size());
}

void expect_range(const std::vector<double>& values, double low, double high) {
  const auto [least, most] = std::minmax_element(values.begin(), values.end());
  const double slack = 0.02 * (high - low);
  EXPECT_GE(*least, low);
  EXPECT_LE(*most, high);
  EXPECT_NEAR(*least, low, slack);
  EXPECT_NEAR(*most, high, slack);
  EXPECT_NEAR(mean(values), (low + high) / 2, 2 * slack);
}

TEST(Views, DependOnNameSeedAndIndexAlone) {
  for (const std::string& name : names_of<ViewDistribution>()) {
    const auto all = sample_views(parse_enum<ViewDistribution>(name), 5, 0, 20, 64, {});
    const auto part = sample_views(parse_enum<ViewDistribution>(name), 5, 7, 3, 64, {});
    for (size_t i = 0; i < 3; ++i) {
      EXPECT_EQ(part[i].camera.camera_to_world, all[7 + i].camera.camera_to_world) << name;
    }
    const auto other = sample_views(parse_enum<ViewDistribution>(name), 6, 0, 1, 64, {});
    EXPECT_NE(other[0].camera.camera_to_world, all[0].camera.camera_to_world) << name;
  }
}

TEST(Views, PosesAreRigid) {
  for (const std::string& name : names_of<ViewDistribution>()) {
    for (const SampledView& view :
         sample_views(parse_enum<ViewDistribution>(name), 1, 0, 200, 64, off_centre_frame())) {
      const auto& m = view.camera.camera_to_world;
      for (int a = 0; a < 3; ++a) {
        for (int b = 0; b < 3; ++b) {
          const double d = m[a] * m[b] + m[4 + a] * m[4 + b] + m[8 + a] * m[8 + b];
          EXPECT_NEAR(d, a == b ? 1 : 0, 1e-12);
        }
      }
      // Right-handed: x cross y = z, checked in one component.
      EXPECT_NEAR(m[4] * m[9] - m[8] * m[5], m[2], 1e-12);
    }
  }
}

TEST(Views, CentreProjectsNearTheMiddleAndUpIsUp) {
  for (const std::string& name : names_of<ViewDistribution>()) {
    const ViewFrame frame = off_centre_frame();
    for (const SampledView& view :
         sample_views(parse_enum<ViewDistribution>(name), 2, 0, 100, 100, frame)) {
      const auto clip = world_to_clip(view.camera, 0.1, 10);
      double out[4];
      for (int r = 0; r < 4; ++r) {
        out[r] = clip[4 * r] * frame.centre[0] + clip[4 * r + 1] * frame.centre[1] +
                 clip[4 * r + 2] * frame.centre[2] + clip[4 * r + 3];
      }
      EXPECT_NEAR(out[3], view.distance, 0.2);
      EXPECT_LT(std::abs(out[0] / out[3]), 0.1) << name;
      EXPECT_LT(std::abs(out[1] / out[3]), 0.1) << name;
      if (name == "ring") {
        EXPECT_GT(view.camera.camera_to_world[9], 0.9);
      }
    }
  }
}

TEST(Views, RangesOfDome) {
  const auto views = sample_views(ViewDistribution::kDome, 3, 0, 4000, 64, off_centre_frame());
  expect_range(field(views, &SampledView::azimuth_deg), 0, 360);
  expect_range(field(views, &SampledView::elevation_deg), -20, 75);
  expect_range(field(views, &SampledView::distance), 0.95 * 3, 1.25 * 3);
  expect_range(field(views, &SampledView::roll_deg), -10, 10);
}

TEST(Views, RingAndSphere) {
  const auto ring = sample_views(ViewDistribution::kRing, 3, 0, 2000, 64, off_centre_frame());
  expect_range(field(ring, &SampledView::azimuth_deg), 0, 360);
  for (const SampledView& view : ring) {
    EXPECT_EQ(view.elevation_deg, 15);
    EXPECT_NEAR(view.camera.position()[2], -1 + 3 * std::sin(15 * std::numbers::pi / 180), 1e-12);
  }
  std::vector<double> heights;
  for (const SampledView& view : sample_views(ViewDistribution::kSphere, 3, 0, 4000, 64, {})) {
    heights.push_back(view.camera.position()[2] / 4);
  }
  expect_range(heights, -1, 1);  // uniform over directions: uniform in z (Archimedes)
}

TEST(Views, AnglesDescribeThePose) {
  for (const std::string& name : names_of<ViewDistribution>()) {
    const ViewFrame frame;  // centre at the origin
    for (const SampledView& view :
         sample_views(parse_enum<ViewDistribution>(name), 4, 0, 100, 64, frame)) {
      const auto& m = view.camera.camera_to_world;
      const double azimuth = view.azimuth_deg * std::numbers::pi / 180;
      const double elevation = view.elevation_deg * std::numbers::pi / 180;
      EXPECT_NEAR(m[2], std::cos(elevation) * std::cos(azimuth), 1e-9);
      EXPECT_NEAR(m[6], std::cos(elevation) * std::sin(azimuth), 1e-9);
      EXPECT_NEAR(m[10], std::sin(elevation), 1e-9);
      // Height of the x axis: sin(roll) cos(elevation).
      const double roll = view.roll_deg * std::numbers::pi / 180;
      EXPECT_NEAR(m[8], std::sin(roll) * std::cos(elevation), 1e-9) << name;
    }
  }
}

TEST(Views, UnknownNameSuggestsTheNearest) {
  try {
    (void)parse_enum<ViewDistribution>("domes");
    FAIL();
  } catch (const InputError& error) {
    EXPECT_NE(std::string(error.what()).find("'dome'"), std::string::npos);
  }
}

TEST(Views, WorldToClipMatchesThePinholeFormula) {
  Camera camera;
  camera.camera_to_world = {1, 0, 0, 2, 0, 1, 0, 3, 0, 0, 1, 10, 0, 0, 0, 1};
  camera.width = 200;
  camera.height = 100;
  camera.fx = 120;
  camera.fy = 110;
  camera.cx = 90;
  camera.cy = 60;
  const auto clip = world_to_clip(camera, 1, 20);
  // A point 5 in front, 1 right, 2 up: column 90 + 120/5, row 60 - 110 * 2/5.
  const double p[4] = {3, 5, 5, 1};
  double out[4] = {};
  for (int r = 0; r < 4; ++r) {
    for (int c = 0; c < 4; ++c) out[r] += clip[4 * r + c] * p[c];
  }
  EXPECT_NEAR((out[0] / out[3] + 1) / 2 * 200, 114, 1e-9);
  EXPECT_NEAR((1 - out[1] / out[3]) / 2 * 100, 16, 1e-9);
  EXPECT_DOUBLE_EQ(out[3], 5);
  // Near and far planes map to -1 and 1.
  EXPECT_NEAR((clip[10] * 9 + clip[11]) / 1, -1, 1e-12);
  EXPECT_NEAR((clip[10] * -10 + clip[11]) / 20, 1, 1e-12);
}

}  // namespace
}  // namespace tt3d::scene
