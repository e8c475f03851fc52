#include "tt3d/appearance.h"

#include <gtest/gtest.h>

#include "attack/toy_attack.h"
#include "support/gradient_check.h"
#include "support/shapes.h"
#include "tt3d/asset.h"
#include "tt3d/object.h"
#include "tt3d/raster.h"
#include "tt3d/surface.h"

namespace tt3d::object {
namespace {

using at::Tensor;

/// A square of side 1 in the plane z = 0, made of two triangles, with one colour per corner.
struct Square {
  Tensor vertices =
      at::tensor({0.F, 0.F, 0.F, 1.F, 0.F, 0.F, 1.F, 1.F, 0.F, 0.F, 1.F, 0.F}).view({4, 3});
  Tensor faces = at::tensor({0, 1, 2, 0, 2, 3}, at::kInt).view({2, 3});
  Tensor colors =
      at::tensor({0.F, 0.F, 0.F, 1.F, 0.F, 0.F, 1.F, 1.F, 0.F, 0.F, 1.F, 0.F}).view({4, 3});
};

TEST(VertexColors, AreInterpolatedWithBarycentricWeights) {
  const Square s;
  const VertexColorAppearance look(s.colors, s.faces);
  const Tensor rast = at::tensor({0.5F, 0.25F, 0.F, 1.F, 0.F, 0.F, 0.F, 2.F}).view({2, 4});
  const Tensor color = look.color({Tensor(), rast});
  // The weights are 1/2 for corner 0 and 1/4 for corners 1 and 2; then 1 for corner 3.
  EXPECT_TRUE(at::allclose(color.select(1, 0), at::tensor({0.5F, 0.25F, 0.F})));
  EXPECT_TRUE(at::allclose(color.select(1, 1), at::tensor({0.F, 1.F, 0.F})));
}

TEST(VertexColors, GradientAgainstCentralDifferences) {
  const Square s;
  const Tensor rast = at::tensor({0.5, 0.25, 0., 1., 0.1, 0.7, 0., 2.}).view({2, 4});
  const double error = testing::gradient_error(
      [&](const std::vector<Tensor>& in) {
        const VertexColorAppearance look(in[0], s.faces);
        return look.color({Tensor(), rast}).pow(3).sum();
      },
      {testing::uniform({4, 3}, 0, 1, 2)});
  EXPECT_LT(error, 1e-6);
}

TEST(VertexColors, AreSampledFromAnotherAppearanceAtTheVertices) {
  const attack::AttackInput ball = testing::ball_input(0);
  const auto sampled = VertexColorAppearance::sample(*ball.object.appearance, ball.object.mesh);
  const Tensor direct = ball.object.appearance->color({ball.object.mesh.vertices, Tensor()});
  EXPECT_TRUE(at::equal(sampled->parameters()[0], direct.t()));
  // Sampling again, now from the triangles, changes nothing.
  const auto again = VertexColorAppearance::sample(*sampled, ball.object.mesh);
  EXPECT_TRUE(at::equal(again->parameters()[0], direct.t()));
}

TEST(VertexColors, AreClampedToTheirRange) {
  const Square s;
  const VertexColorAppearance look(at::tensor({-1.F, 0.5F, 2.F}).expand({4, 3}).clone(), s.faces);
  look.constrain();
  EXPECT_TRUE(at::equal(look.parameters()[0][0], at::tensor({0.F, 0.5F, 1.F})));
}

TEST(VertexColors, AreBakedAsTheyAreRendered) {
  // The atlas is the square itself, so red and green increase along the axes of the texture.
  const Square s;
  const VertexColorAppearance look(s.colors, s.faces);
  const scene::UvMap atlas = {s.vertices.narrow(1, 0, 2).contiguous(), s.faces};
  const Tensor texture =
      asset::bake_texture(atlas, 16, {s.vertices, s.faces},
                          [&](const raster::SurfacePoints& p) { return look.color(p); });
  const Tensor middles = (at::arange(16) + 0.5) / 16 * 255;
  const Tensor red = texture.select(2, 0).to(at::kFloat), green = texture.select(2, 1);
  EXPECT_LE((red - middles.view({1, 16})).abs().max().item<double>(), 0.51);
  EXPECT_LE((green.to(at::kFloat) - middles.view({16, 1})).abs().max().item<double>(), 0.51);
}

TEST(GridMlp, GroupsHoldEveryParameterOnce) {
  const attack::AttackInput ball = testing::ball_input(0);
  const auto groups = ball.object.appearance->groups();
  ASSERT_EQ(groups.size(), 2U);
  EXPECT_EQ(groups[0].part, Part::kGrid);
  EXPECT_EQ(groups[1].part, Part::kMlp);
  EXPECT_EQ(ball.object.appearance->parameters().size(), 4U);
}

}  // namespace
}  // namespace tt3d::object
