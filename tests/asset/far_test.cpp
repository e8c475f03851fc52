#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include <fstream>
#include <iomanip>
#include <sstream>

#include "asset/gltf_builder.h"
#include "support/shapes.h"
#include "support/temporary_folder.h"
#include "tt3d/core.h"

// Assets whose coordinates are too large for float32: Earth-centred or UTM.

namespace tt3d::asset {
namespace {

using testing::GltfBuilder;

/// An OBJ of a sphere of radius 0.5 around a point, with as many digits as a double has.
std::string sphere_obj(const std::array<double, 3>& centre) {
  const testing::Shape ball = testing::sphere(3);
  std::ostringstream text;
  text << std::setprecision(17);
  for (int64_t i = 0; i < ball.vertices.size(0); ++i) {
    text << "v";
    for (int64_t k = 0; k < 3; ++k) {
      text << " " << centre[static_cast<size_t>(k)] + 0.5 * ball.vertices[i][k].item<double>();
    }
    text << "\n";
  }
  for (int64_t i = 0; i < ball.faces.size(0); ++i) {
    text << "f";
    for (int64_t k = 0; k < 3; ++k) text << " " << ball.faces[i][k].item<int32_t>() + 1;
    text << "\n";
  }
  return text.str();
}

class Far : public ::testing::Test {
 protected:
  static constexpr std::array<double, 3> kCentre = {500000.123, 4000000.456, 312.5};

  void expect_sphere(const TexturedMesh& mesh) {
    EXPECT_NEAR(testing::surface_area(mesh), 3.1, 0.05);
    const at::Tensor low = std::get<0>(mesh.vertices.min(0)).to(at::kDouble);
    const at::Tensor high = std::get<0>(mesh.vertices.max(0)).to(at::kDouble);
    for (int64_t k = 0; k < 3; ++k) {
      const auto axis = static_cast<size_t>(k);
      const double centre = 0.5 * (low[k] + high[k]).item<double>() + mesh.origin[axis];
      EXPECT_NEAR(centre, kCentre[axis], 1e-5) << k;
    }
  }

  testing::TemporaryFolder folder_;
};

TEST_F(Far, OriginIsZeroForOrdinaryBoxes) {
  const std::array<double, 3> zero = {0, 0, 0};
  EXPECT_EQ(far_origin({-1, -1, -1}, {1, 1, 1}), zero);
  EXPECT_EQ(far_origin({100, 100, 100}, {101, 101, 101}), zero);
  EXPECT_EQ(far_origin({5, 5, 5}, {5, 5, 5}), zero);
  EXPECT_EQ(far_origin({1000.3, 0, -7}, {1001.3, 0.5, -6}), (std::array<double, 3>{1001, 0, -7}));
}

TEST_F(Far, ObjKeepsItsDigitsAndItsCoordinates) {
  write_file_atomic(folder_ / "far.obj", sphere_obj(kCentre));
  const TexturedMesh mesh = load_asset(folder_ / "far.obj");
  expect_sphere(mesh);
  write_glb(mesh, folder_ / "again.glb");
  write_obj(mesh, folder_ / "again.obj");
  const TexturedMesh glb = load_asset(folder_ / "again.glb");
  expect_sphere(glb);
  EXPECT_EQ(glb.vertices.size(0), mesh.vertices.size(0));
  expect_sphere(load_asset(folder_ / "again.obj"));
  const std::string text = read_file(folder_ / "again.obj");
  EXPECT_NE(text.find("v 500000."), std::string::npos);
  EXPECT_NE(text.find(" 4000000."), std::string::npos);
}

TEST_F(Far, GlbUnderATranslatedNode) {
  GltfBuilder glb;
  glb.use_texture();
  glb.node()["translation"] = {4000000.25, 300000.5, -5000000.125};
  glb.save(folder_ / "far.glb");
  const TexturedMesh mesh = load_asset(folder_ / "far.glb");
  EXPECT_EQ(mesh.vertices.size(0), 4);
  EXPECT_NEAR(testing::surface_area(mesh), 1, 1e-6);
  const std::array<double, 3> world = {4000000.25, 5000000.125, 300000.5};
  testing::expect_colour(mesh,
                         {world[0] - mesh.origin[0] + 0.25, world[1] - mesh.origin[1],
                          world[2] - mesh.origin[2] + 0.75},
                         {220, 30, 30});
}

TEST_F(Far, StrayVerticesDoNotCount) {
  write_file_atomic(folder_ / "far.obj", "v 0 0 0\n" + sphere_obj(kCentre));
  std::string text = read_file(folder_ / "far.obj");
  // The faces count from 1 again: skip the stray vertex by counting from the end.
  const TexturedMesh mesh = load_asset(folder_ / "far.obj");
  EXPECT_EQ(mesh.origin, (std::array<double, 3>{0, 0, 0}));
  text.erase(text.find("f "));
  text += "f -1 -2 -3\n";
  write_file_atomic(folder_ / "far.obj", text);
  EXPECT_NE(load_asset(folder_ / "far.obj").origin, (std::array<double, 3>{0, 0, 0}));
}

TEST_F(Far, FramesAndComparedAssetsShareTheOrigin) {
  write_file_atomic(folder_ / "a.obj", sphere_obj(kCentre));
  write_file_atomic(folder_ / "b.obj", sphere_obj({kCentre[0] + 0.7, kCentre[1], kCentre[2]}));
  AssetFiles files;
  const TexturedMesh& a = files.load(folder_ / "a.obj");
  const TexturedMesh& b = files.load(folder_ / "b.obj");
  EXPECT_EQ(a.origin, b.origin);
  const at::Tensor shift = (b.vertices - a.vertices).mean(0);
  EXPECT_NEAR(shift[0].item<double>(), 0.7, 1e-5);
  scene::ViewFrame frame{kCentre, 1, 3, 40};
  write_view_frame(frame, folder_.path());
  frame = view_frame(a, folder_ / "a.obj");
  EXPECT_NEAR(frame.centre[0] + a.origin[0], kCentre[0], 1e-9);
}

TEST_F(Far, PlyHasDoubles) {
  const testing::Shape ball = testing::sphere(1);
  write_ply({ball.vertices, ball.faces}, folder_ / "m.ply", {4000000.25, 0, 0});
  const std::string bytes = read_file(folder_ / "m.ply");
  EXPECT_NE(bytes.find("property double x"), std::string::npos);
  double first = 0;
  std::memcpy(&first, bytes.data() + bytes.find("end_header\n") + 11, sizeof first);
  EXPECT_EQ(first, 4000001.25);
}

}  // namespace
}  // namespace tt3d::asset
