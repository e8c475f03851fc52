#include "attack/sticker.h"

#include <gtest/gtest.h>

#include <cmath>

#include "attack/toy_attack.h"
#include "support/temporary_folder.h"
#include "tt3d/attack.h"
#include "tt3d/image.h"
#include "tt3d/raster.h"
#include "tt3d/surface.h"

namespace tt3d::attack {
namespace {

using at::Tensor;

/// Centres of the faces of a mesh, [F,3].
Tensor face_centres(const scene::TriMesh& mesh) {
  return mesh.vertices.index_select(0, mesh.faces.flatten().to(at::kLong)).view({-1, 3, 3}).mean(1);
}

/// The centre of each face as a surface point.
raster::SurfacePoints face_centre_points(const scene::TriMesh& mesh) {
  const int64_t faces = mesh.faces.size(0);
  const Tensor third = at::full({faces}, 1.0 / 3), number = at::arange(1, faces + 1);
  return {face_centres(mesh), at::stack({third, third, at::zeros({faces}), number}, 1)};
}

TEST(Sticker, IsARoundPatchOfItsArea) {
  const scene::TriMesh ball = testing::ball_input(0).object.mesh;
  for (const double area : {0.05, 0.3}) {
    const Tensor chosen = sticker_faces(ball, area, 90, 0);
    // The faces of a ball have about the same size, and its patches are caps of height 2 * area *
    // r.
    EXPECT_NEAR(chosen.to(at::kDouble).mean().item<double>(), area, 0.02);
    const Tensor y = face_centres(ball).select(1, 1) / 0.7;
    EXPECT_GT(y.masked_select(chosen).min().item<double>(), 1 - 2 * area - 0.15);
    EXPECT_LT(y.masked_select(~chosen).max().item<double>(), 1 - 2 * area + 0.15);
  }
  EXPECT_GT(sticker_faces(ball, 1, 0, 0).sum().item<int64_t>(), ball.faces.size(0) - 2);
  const Tensor top = sticker_faces(ball, 0.05, 0, 90);
  EXPECT_GT(face_centres(ball).select(1, 2).masked_select(top).min().item<double>(), 0.4);
}

TEST(Sticker, KeepsEveryBitOfTheOutside) {
  Progress quiet;
  testing::TemporaryFolder folder;
  const AttackInput input = testing::ball_input(0);
  const raster::SurfacePoints points = face_centre_points(input.object.mesh);
  const Tensor clean = input.object.appearance->color(points);
  using object::Part;
  for (const std::vector<Part>& parts :
       {std::vector<Part>{Part::kGrid, Part::kMlp}, {Part::kVertexColors}}) {
    AttackOptions o = testing::toy_options(attack_preset("sticker"));
    o.optimize = parts;
    o.sticker.area = 0.2;
    const AttackResult r = run_attack(input, o, 1, folder / name_of(parts[0]), quiet);
    const Tensor inside = sticker_faces(input.object.mesh, 0.2, 0, 0);
    save_attack(r, folder / "r.safetensors");
    const object::Object back = object::load_object(folder / "r.safetensors");
    for (const auto& look : {r.object.appearance, back.appearance}) {
      const Tensor same = (look->color(points) == clean).all(0);
      EXPECT_TRUE(same.masked_select(~inside).all().item<bool>());
      EXPECT_FALSE(same.masked_select(inside).any().item<bool>());
    }
    EXPECT_TRUE(at::equal(r.object.appearance->color(points), back.appearance->color(points)));
    // The free faces changed towards red.
    const Tensor red = (r.object.appearance->color(points) - clean)[0].masked_select(inside);
    EXPECT_GT(red.mean().item<double>(), 0.05);
  }
}

TEST(Sticker, AMaskFreesTheFacesInItsLightParts) {
  Progress quiet;
  testing::TemporaryFolder folder;
  const AttackInput input = testing::ball_input(0);
  // v of the map grows with height, so the white lower half of the picture is the upper half of the
  // ball.
  Tensor mask = at::zeros({20, 10, 3}, at::kByte);
  mask.narrow(0, 10, 10).fill_(255);
  write_file_atomic(folder / "mask.png", image::encode_png(mask));
  const Tensor inside = masked_faces(*input.object.map, image::read_image(folder / "mask.png"));
  const Tensor height = face_centres(input.object.mesh).select(1, 2);
  EXPECT_TRUE(at::equal(inside, height >= 0));
  AttackOptions o = testing::toy_options(attack_preset("sticker"));
  o.sticker.mask = folder / "mask.png";
  EXPECT_TRUE(needs_uv_map(o));
  o.schedule.steps = 5;
  const AttackResult r = run_attack(input, o, 1, folder / "c", quiet);
  const raster::SurfacePoints points = face_centre_points(input.object.mesh);
  const Tensor same =
      (r.object.appearance->color(points) == input.object.appearance->color(points)).all(0);
  EXPECT_TRUE(at::equal(same, ~inside));
  write_file_atomic(folder / "mask.png", image::encode_png(at::zeros({20, 10, 3}, at::kByte)));
  EXPECT_THROW((void)run_attack(input, o, 1, folder / "d", quiet), InputError);
}

}  // namespace
}  // namespace tt3d::attack
