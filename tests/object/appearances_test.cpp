#include <ATen/core/grad_mode.h>
#include <gtest/gtest.h>

#include "attack/toy_attack.h"
#include "support/gradient_check.h"
#include "support/shapes.h"
#include "tt3d/appearance.h"
#include "tt3d/object.h"
#include "tt3d/raster.h"
#include "tt3d/surface.h"

namespace tt3d::object {
namespace {

using at::Tensor;

/// The unit square in z = 0, made of two triangles; its positions are also its uvs.
struct TexturedSquare {
  Tensor vertices =
      at::tensor({0., 0., 0., 1., 0., 0., 1., 1., 0., 0., 1., 0.}, at::kDouble).view({4, 3});
  Tensor faces = at::tensor({0, 1, 2, 0, 2, 3}, at::kInt).view({2, 3});
  Tensor uvs = vertices.narrow(1, 0, 2).contiguous();
  /// A point of the lower triangle.
  [[nodiscard]] raster::SurfacePoints at(double x, double y) const {
    return {at::tensor({x, y, 0.}, at::kDouble).view({1, 3}),
            at::tensor({1 - x, x - y, 0., 1.}, at::kDouble).view({1, 4})};
  }
};

/// A texture of 2 x 2 texels: red, green; blue, white.
Tensor four_texels() {
  return at::tensor({1., 0., 0., 0., 1., 0., 0., 0., 1., 1., 1., 1.}, at::kDouble).view({2, 2, 3});
}

Tensor color(double r, double g, double b) { return at::tensor({r, g, b}, at::kDouble); }

TEST(TextureAppearance, IsSampledBilinearlyAtTheUvs) {
  const TexturedSquare s;
  const TextureAppearance look(four_texels(), {s.uvs, s.faces}, Part::kTexture);
  EXPECT_TRUE(at::allclose(look.color(s.at(0.25, 0.25)).flatten(), color(1, 0, 0)));
  EXPECT_TRUE(at::allclose(look.color(s.at(0.75, 0.25)).flatten(), color(0, 1, 0)));
  EXPECT_TRUE(at::allclose(look.color(s.at(0.5, 0.25)).flatten(), color(0.5, 0.5, 0)));
  EXPECT_TRUE(at::allclose(look.color(s.at(0.5, 0.5)).flatten(), color(0.5, 0.5, 0.5)));
}

TEST(TextureAppearance, RepeatsBeyondItsBorder) {
  const TexturedSquare s;
  const TextureAppearance once(four_texels(), {s.uvs, s.faces}, Part::kTile);
  const TextureAppearance thrice(four_texels(), {s.uvs * 3, s.faces}, Part::kTile);
  for (const double x : {0.05, 0.2, 0.3}) {
    const Tensor first = thrice.color(s.at(x, 0.02));
    EXPECT_TRUE(at::allclose(first, thrice.color(s.at(x + 1.0 / 3, 0.02))));
    EXPECT_TRUE(at::allclose(first, once.color(s.at(3 * x, 0.06))));
  }
  EXPECT_EQ(thrice.groups()[0].part, Part::kTile);
}

TEST(Triplanar, AFacePerpendicularToAnAxisShowsTheTile) {
  const TexturedSquare s;
  const Tensor up = color(0, 0, 1).expand({4, 3}).contiguous();
  // Two tiles cover the box [-1,1]; the square is one tile.
  const TriplanarAppearance look(four_texels(), up, s.faces, 2);
  const TextureAppearance plain(four_texels(), {s.uvs, s.faces}, Part::kTile);
  for (const auto& [x, y] : {std::pair{0.3, 0.1}, {0.75, 0.25}, {0.9, 0.4}}) {
    EXPECT_TRUE(at::allclose(look.color(s.at(x, y)), plain.color(s.at(x, y))));
  }
}

TEST(Triplanar, AnObliqueFaceBlendsByPowersOfTheNormal) {
  const TexturedSquare s;
  const Tensor slanted = color(0.6, 0, 0.8).expand({4, 3}).contiguous();
  const TriplanarAppearance look(four_texels(), slanted, s.faces, 2);
  // Seen along z at (0.75, 0.25): green. Along x, at (y, z) = (0.25, 0): between red and blue.
  const double x = std::pow(0.6, 4), z = std::pow(0.8, 4);
  const Tensor wanted = (z * color(0, 1, 0) + x * color(0.5, 0, 0.5)) / (x + z);
  EXPECT_TRUE(at::allclose(look.color(s.at(0.75, 0.25)).flatten(), wanted));
}

TEST(Appearances, GradientsAgainstCentralDifferences) {
  const TexturedSquare s;
  raster::SurfacePoints points = s.at(0.3, 0.2);
  points.rast = at::cat({points.rast, s.at(0.8, 0.45).rast});
  points.positions = at::cat({points.positions, s.at(0.8, 0.45).positions});
  const Tensor texels = testing::uniform({4, 4, 3}, 0, 1, 1);
  EXPECT_LT(testing::gradient_error(
                [&](const std::vector<Tensor>& in) {
                  const TextureAppearance look(in[0], {s.uvs, s.faces}, Part::kTexture);
                  return look.color(points).pow(3).sum();
                },
                {texels}),
            1e-6);
  const Tensor normals = testing::uniform({4, 3}, 0.2, 1, 2);
  EXPECT_LT(testing::gradient_error(
                [&](const std::vector<Tensor>& in) {
                  const TriplanarAppearance look(in[0], normals, s.faces, 3);
                  return look.color(points).pow(3).sum();
                },
                {texels}),
            1e-6);
  const auto base = std::make_shared<TextureAppearance>(texels * 0.3, scene::UvMap{s.uvs, s.faces},
                                                        Part::kTexture);
  EXPECT_LT(
      testing::gradient_error(
          [&](const std::vector<Tensor>& in) {
            const ShadedAppearance look(base, in[0], in[1], in[2], s.faces);
            return look.color(points).pow(3).sum();
          },
          {testing::uniform({4, 3}, 0.2, 0.6, 3), normals, testing::uniform({9, 3}, 0.1, 0.4, 4)}),
      1e-6);
}

TEST(Shaded, EvenLightGivesTheAppearanceItself) {
  const attack::AttackInput ball = testing::ball_input(0);
  const auto& [vertices, faces] = ball.object.mesh;
  const auto lit = ShadedAppearance::evenly_lit(ball.object.appearance,
                                                scene::vertex_normals(vertices, faces), faces);
  const Tensor third = at::full({40}, 1.F / 3), number = at::arange(1, 41).to(at::kFloat);
  const raster::SurfacePoints points = {vertices.narrow(0, 0, 40),
                                        at::stack({third, third, third, number}, 1)};
  EXPECT_TRUE(at::allclose(lit->color(points), ball.object.appearance->color(points), 1e-5, 1e-6));
}

TEST(Shaded, ALightFromAboveLightensUpwardFaces) {
  const TexturedSquare s;
  const auto white = std::make_shared<TextureAppearance>(
      at::ones({2, 2, 3}, at::kDouble), scene::UvMap{s.uvs, s.faces}, Part::kTexture);
  const Tensor half = at::full({4, 3}, 0.5, at::kDouble);
  Tensor lights = at::zeros({9, 3}, at::kDouble);
  lights[0].fill_(0.5);
  lights[3].fill_(0.5);
  for (const double up : {1.0, -1.0}) {
    const Tensor normals = color(0, 0, up).expand({4, 3}).contiguous();
    const ShadedAppearance look(white, half, normals, lights, s.faces);
    EXPECT_NEAR(look.color(s.at(0.3, 0.2))[0][0].item<double>(), up > 0 ? 0.5 : 0, 1e-9);
  }
}

TEST(Surface, RandomPointsAreUniform) {
  // A square beside a triangle with a quarter of its area.
  scene::TriMesh mesh;
  mesh.vertices = at::tensor({0.F, 0.F, 0.F, 1.F, 0.F, 0.F, 1.F, 1.F,  0.F, 0.F, 1.F, 0.F,  //
                              2.F, 0.F, 0.F, 3.F, 0.F, 0.F, 2.F, 0.5F, 0.F})
                      .view({7, 3});
  mesh.faces = at::tensor({0, 1, 2, 0, 2, 3, 4, 5, 6}, at::kInt).view({3, 3});
  const raster::SurfacePoints points = sample_surface(mesh, 4000, Random(1, "test", 0));
  const Tensor x = points.positions.select(1, 0), y = points.positions.select(1, 1);
  EXPECT_NEAR((x > 1.5).to(at::kDouble).mean().item<double>(), 0.2, 0.025);
  const Tensor square = (x < 1.5).nonzero().flatten();
  for (const Tensor& axis : {x, y}) {
    const Tensor on_square = axis.index_select(0, square).to(at::kDouble);
    EXPECT_NEAR(on_square.mean().item<double>(), 0.5, 0.02);
    EXPECT_NEAR(on_square.var().item<double>(), 1.0 / 12, 0.005);
  }
  // Triangle and weights give the same position.
  const Tensor again =
      raster::interpolate(mesh.vertices, points.rast.view({1, 1, -1, 4}), mesh.faces);
  EXPECT_TRUE(at::allclose(again.view({-1, 3}), points.positions, 0, 1e-6));
}

TEST(GridMlp, IsFittedToAnotherAppearance) {
  Progress quiet;
  const attack::AttackInput ball = testing::ball_input(0);
  const VertexColorAppearance look((ball.object.mesh.vertices / 1.4 + 0.5).contiguous(),
                                   ball.object.mesh.faces);
  field::FieldShape shape;
  shape.appearance = {6, 8, 64, 12, 2};
  const auto fitted = fit_grid_mlp(look, ball.object.mesh, shape, 1, 150, {}, quiet);
  const raster::SurfacePoints points = sample_surface(ball.object.mesh, 1000, Random(2, "test", 0));
  at::NoGradGuard guard;
  const Tensor error = fitted->color(points) - look.color(points);
  EXPECT_LT(error.square().mean().item<double>(), 1e-4);  // 40 dB
}

}  // namespace
}  // namespace tt3d::object
