#include "tt3d/lighting.h"

#include <gtest/gtest.h>

#include <cmath>

#include "attack/color_space.h"
#include "support/gradient_check.h"
#include "support/shapes.h"
#include "tt3d/core.h"
#include "tt3d/mesh.h"
#include "tt3d/object.h"
#include "tt3d/surface.h"

namespace tt3d::object {
namespace {

using at::Tensor;

TEST(Lighting, TermsEqualAComputationByHand) {
  const Tensor n = at::tensor({0.6, 0.0, 0.8}, at::kDouble).view({3, 1});
  const Tensor wanted =
      at::tensor({1.0, 0.6, 0.0, 0.8, 0.0, 0.0, 3 * 0.64 - 1, 0.48, 0.36}, at::kDouble);
  EXPECT_TRUE(at::allclose(irradiance_terms(n).flatten(), wanted));
}

TEST(Lighting, IrradianceIsNeverNegative) {
  Tensor lights = at::zeros({9, 3}, at::kDouble);
  lights[0] = at::tensor({0.5, 0.5, 0.5}, at::kDouble);
  lights[3] = at::tensor({1.0, 0.5, 0.0}, at::kDouble);  // from above
  const Tensor up_and_down = at::tensor({0., 0., 0., 0., 3., -3.}, at::kDouble).view({3, 2});
  const Tensor e = irradiance(up_and_down, lights);
  EXPECT_TRUE(at::allclose(e.select(1, 0), at::tensor({1.5, 1.0, 0.5}, at::kDouble)));
  EXPECT_TRUE(at::allclose(e.select(1, 1), at::tensor({0.0, 0.0, 0.5}, at::kDouble)));
}

TEST(Lighting, TheLobeIsCloseToTheClampedCosine) {
  const Tensor c = at::linspace(-1, 1, 2001, at::kDouble);
  const Tensor exact = c.clamp_min(0);
  EXPECT_LT((lobe(c) - exact).abs().max().item<double>(), 0.1);
  // Uniform cosines are uniform directions on the sphere. Compare the moments of the irradiance.
  EXPECT_NEAR(lobe(c).mean().item<double>(), 0.25, 1e-3);
  EXPECT_NEAR((lobe(c) * c).mean().item<double>(), (exact * c).mean().item<double>(), 1e-3);
  EXPECT_NEAR((lobe(c) * c * c).mean().item<double>(), (exact * c * c).mean().item<double>(), 1e-3);
}

TEST(Lighting, GradientAgainstCentralDifferences) {
  const double error = testing::gradient_error(
      [](const std::vector<Tensor>& in) { return irradiance(in[0], in[1]).square().sum(); },
      {testing::uniform({3, 5}, 0.2, 1, 1), testing::uniform({9, 3}, 0.1, 1, 2)});
  EXPECT_LT(error, 1e-6);
}

TEST(VertexNormals, PointOutwardOnABall) {
  const testing::Shape ball = testing::sphere(3, 0.7F);
  const Tensor normals = scene::vertex_normals(ball.vertices, ball.faces);
  EXPECT_GT((normals * ball.vertices / 0.7).sum(1).min().item<double>(), 0.998);
  EXPECT_LT((normals.norm(2, {1}) - 1).abs().max().item<double>(), 1e-5);
}

TEST(VertexNormals, GradientAgainstCentralDifferences) {
  const testing::Shape ball = testing::sphere(0);
  const Tensor weights = testing::uniform({6, 3}, -1, 1, 3);
  const double error = testing::gradient_error(
      [&](const std::vector<Tensor>& in) {
        return (scene::vertex_normals(in[0], ball.faces) * weights).sum();
      },
      {ball.vertices + testing::uniform({6, 3}, -0.1, 0.1, 4)});
  EXPECT_LT(error, 1e-6);
}

TEST(Lab, EqualsPublishedValues) {
  const Tensor colors =
      at::tensor({1., 0., 0., 0.5, 1., 0., 0., 0.5, 1., 0., 1., 0.5}, at::kDouble).view({3, 4});
  // White, black, blue and middle grey under D65, with the digits of published tables.
  const Tensor wanted = at::tensor({100., 0., 32.297, 53.389,  //
                                    0., 0., 79.188, 0.,        //
                                    0., 0., -107.860, 0.},
                                   at::kDouble)
                            .view({3, 4});
  EXPECT_LT((attack::lab_of_srgb(colors) - wanted).abs().max().item<double>(), 0.02);
}

TEST(Lab, GradientAgainstCentralDifferences) {
  // Also in the linear parts of both curves, and at black.
  const double error = testing::gradient_error(
      [](const std::vector<Tensor>& in) { return attack::lab_of_srgb(in[0]).square().sum(); },
      {at::cat({testing::uniform({3, 4}, 0.1, 1, 1), at::full({3, 1}, 0.01, at::kDouble)}, 1)});
  EXPECT_LT(error, 1e-6);
  Tensor black = at::zeros({3, 1}).requires_grad_(true);
  const Tensor grad = torch::autograd::grad({attack::lab_of_srgb(black).sum()}, {black})[0];
  EXPECT_TRUE(grad.isfinite().all().item<bool>());
}

TEST(Lab, DistancesEqualAComputationByHand) {
  const Tensor white = at::ones({3, 1}), black = at::zeros({3, 1});
  EXPECT_NEAR(attack::color_distance(attack::ColorSpace::kRgb, white, black).item<double>(), 3,
              1e-6);
  EXPECT_NEAR(attack::color_distance(attack::ColorSpace::kLab, white, black).item<double>(), 1,
              1e-4);
}

}  // namespace
}  // namespace tt3d::object
