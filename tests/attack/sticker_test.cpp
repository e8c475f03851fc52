#include "attack/sticker.h"

#include <gtest/gtest.h>

#include <cmath>

#include "attack/toy_attack.h"
#include "support/temporary_folder.h"

namespace tt3d {
namespace {

using at::Tensor;

/// Middles of a mesh's faces, [F,3].
Tensor middles(const TriMesh& mesh) {
  return mesh.vertices.index_select(0, mesh.faces.flatten().to(at::kLong)).view({-1, 3, 3}).mean(1);
}

/// The middle of each face as a surface point.
SurfacePoints middle_points(const TriMesh& mesh) {
  const int64_t faces = mesh.faces.size(0);
  const Tensor third = at::full({faces}, 1.0 / 3), number = at::arange(1, faces + 1);
  return {middles(mesh), at::stack({third, third, at::zeros({faces}), number}, 1)};
}

TEST(Sticker, IsARoundPatchOfItsArea) {
  const TriMesh ball = testing::ball_input(0).mesh;
  for (const double area : {0.05, 0.3}) {
    const Tensor chosen = sticker_faces(ball, area, 90, 0);
    // A ball's faces are of about one size, and its patches are caps: of height 2 area r.
    EXPECT_NEAR(chosen.to(at::kDouble).mean().item<double>(), area, 0.02);
    const Tensor y = middles(ball).select(1, 1) / 0.7;
    EXPECT_GT(y.masked_select(chosen).min().item<double>(), 1 - 2 * area - 0.15);
    EXPECT_LT(y.masked_select(~chosen).max().item<double>(), 1 - 2 * area + 0.15);
  }
  EXPECT_GT(sticker_faces(ball, 1, 0, 0).sum().item<int64_t>(), ball.faces.size(0) - 2);
  const Tensor top = sticker_faces(ball, 0.05, 0, 90);
  EXPECT_GT(middles(ball).select(1, 2).masked_select(top).min().item<double>(), 0.4);
}

TEST(Sticker, LeavesTheOutsideUntouchedToTheLastBit) {
  Progress quiet;
  testing::TemporaryFolder folder;
  const AttackInput input = testing::ball_input(0);
  const SurfacePoints points = middle_points(input.mesh);
  const Tensor clean = input.appearance->color(points);
  for (const std::vector<std::string>& parts :
       {std::vector<std::string>{"grid", "mlp"}, {"vertex-colors"}}) {
    AttackOptions o = testing::toy_options(attack_preset("sticker"));
    o.optimize = parts;
    o.sticker_area = 0.2;
    const AttackResult r = run_attack(input, o, 1, folder / parts[0], quiet);
    const Tensor inside = sticker_faces(input.mesh, 0.2, 0, 0);
    save_attack(r, folder / "r.safetensors");
    const AttackResult back = load_attack(folder / "r.safetensors");
    for (const auto& look : {r.appearance, back.appearance}) {
      const Tensor same = (look->color(points) == clean).all(0);
      EXPECT_TRUE(same.masked_select(~inside).all().item<bool>());
      EXPECT_FALSE(same.masked_select(inside).any().item<bool>());
    }
    EXPECT_TRUE(at::equal(r.appearance->color(points), back.appearance->color(points)));
    // What may change moved towards red.
    const Tensor red = (r.appearance->color(points) - clean)[0].masked_select(inside);
    EXPECT_GT(red.mean().item<double>(), 0.05);
  }
}

TEST(Sticker, ADrawnMaskFreesWhatItShowsLight) {
  Progress quiet;
  testing::TemporaryFolder folder;
  const AttackInput input = testing::ball_input(0);
  // The map's v is height: the lower half of the picture, drawn white, is the upper half ball.
  Tensor mask = at::zeros({20, 10, 3}, at::kByte);
  mask.narrow(0, 10, 10).fill_(255);
  write_file_atomic(folder / "mask.png", encode_png(mask));
  const Tensor inside = masked_faces(input.map, read_image(folder / "mask.png"));
  const Tensor height = middles(input.mesh).select(1, 2);
  EXPECT_TRUE(at::equal(inside, height >= 0));
  AttackOptions o = testing::toy_options(attack_preset("sticker"));
  o.sticker_mask = folder / "mask.png";
  EXPECT_TRUE(needs_texture_map(o));
  o.steps = 5;
  const AttackResult r = run_attack(input, o, 1, folder / "c", quiet);
  const SurfacePoints points = middle_points(input.mesh);
  const Tensor same = (r.appearance->color(points) == input.appearance->color(points)).all(0);
  EXPECT_TRUE(at::equal(same, ~inside));
  write_file_atomic(folder / "mask.png", encode_png(at::zeros({20, 10, 3}, at::kByte)));
  EXPECT_THROW((void)run_attack(input, o, 1, folder / "d", quiet), InputError);
}

}  // namespace
}  // namespace tt3d
