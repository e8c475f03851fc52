#include "tt3d/appearance.h"

#include <gtest/gtest.h>

#include "attack/toy_attack.h"
#include "support/gradient_check.h"
#include "support/shapes.h"
#include "tt3d/bake.h"

namespace tt3d {
namespace {

using at::Tensor;

/// A square of side 1 in the plane z = 0 out of two triangles, a colour a corner.
struct Square {
  Tensor vertices =
      at::tensor({0.F, 0.F, 0.F, 1.F, 0.F, 0.F, 1.F, 1.F, 0.F, 0.F, 1.F, 0.F}).view({4, 3});
  Tensor faces = at::tensor({0, 1, 2, 0, 2, 3}, at::kInt).view({2, 3});
  Tensor colors =
      at::tensor({0.F, 0.F, 0.F, 1.F, 0.F, 0.F, 1.F, 1.F, 0.F, 0.F, 1.F, 0.F}).view({4, 3});
};

TEST(VertexColors, AreBlendedByTheWeightsOfTheCorners) {
  const Square s;
  const VertexColorAppearance look(s.colors, s.faces);
  const Tensor rast = at::tensor({0.5F, 0.25F, 0.F, 1.F, 0.F, 0.F, 0.F, 2.F}).view({2, 4});
  const Tensor color = look.color({Tensor(), rast});
  // Half of corner 0, a quarter of corners 1 and 2; then corner 3 alone.
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

TEST(VertexColors, SampledAreTheLooksAtTheVertices) {
  const AttackInput ball = testing::ball_input(0);
  const auto sampled = VertexColorAppearance::sample(*ball.appearance, ball.mesh);
  const Tensor direct = ball.appearance->color({ball.mesh.vertices, Tensor()});
  EXPECT_TRUE(at::equal(sampled->parameters()[0], direct.t()));
  // Sampling again, through the triangles this time, changes nothing.
  const auto again = VertexColorAppearance::sample(*sampled, ball.mesh);
  EXPECT_TRUE(at::equal(again->parameters()[0], direct.t()));
}

TEST(VertexColors, StayColours) {
  const Square s;
  const VertexColorAppearance look(at::tensor({-1.F, 0.5F, 2.F}).expand({4, 3}).clone(), s.faces);
  look.constrain();
  EXPECT_TRUE(at::equal(look.parameters()[0][0], at::tensor({0.F, 0.5F, 1.F})));
}

TEST(VertexColors, AreBakedAsTheyAreShown) {
  // The atlas is the square itself, so that red and green rise along the texture's axes.
  const Square s;
  const VertexColorAppearance look(s.colors, s.faces);
  const Atlas atlas = {s.vertices.narrow(1, 0, 2).contiguous(), s.faces, 16, 16};
  const Tensor texture = bake_texture(atlas, s.vertices, s.faces,
                                      [&](const SurfacePoints& p) { return look.color(p); });
  const Tensor middles = (at::arange(16) + 0.5) / 16 * 255;
  const Tensor red = texture.select(2, 0).to(at::kFloat), green = texture.select(2, 1);
  EXPECT_LE((red - middles.view({1, 16})).abs().max().item<double>(), 0.51);
  EXPECT_LE((green.to(at::kFloat) - middles.view({16, 1})).abs().max().item<double>(), 0.51);
}

TEST(GridMlp, GroupsHoldEveryParameterOnce) {
  const AttackInput ball = testing::ball_input(0);
  const auto groups = ball.appearance->groups();
  ASSERT_EQ(groups.size(), 2U);
  EXPECT_EQ(groups[0].name, "grid");
  EXPECT_EQ(groups[1].name, "mlp");
  EXPECT_EQ(ball.appearance->parameters().size(), 4U);
}

}  // namespace
}  // namespace tt3d
