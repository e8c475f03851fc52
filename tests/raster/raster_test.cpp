#include "tt3d/raster.h"

#include <gtest/gtest.h>

#include <cmath>
#include <set>

#include "raster/raster_reference.h"
#include "support/shapes.h"

namespace tt3d::raster {
namespace {

using testing::make_shape;
using testing::Shape;

/// Orthographic clip coordinates: x, y unchanged, w = 1.
at::Tensor flat_clip(const std::vector<std::array<float, 3>>& points) {
  at::Tensor clip = at::ones({1, static_cast<int64_t>(points.size()), 4});
  for (size_t i = 0; i < points.size(); ++i) {
    for (int k = 0; k < 3; ++k) clip[0][static_cast<int64_t>(i)][k] = points[i][k];
  }
  return clip;
}

/// A perspective view of a shape from distance 3 along -z, focal length f.
at::Tensor perspective(const at::Tensor& vertices, double f = 1.8) {
  const at::Tensor depth = 3.0 - vertices.select(1, 2);
  const double near = 0.5, far = 10;
  const at::Tensor z = depth * ((far + near) / (far - near)) - 2 * far * near / (far - near);
  return at::stack({vertices.select(1, 0) * f, vertices.select(1, 1) * f, z, depth}, 1)
      .unsqueeze(0);
}

at::Tensor faces_of(const std::vector<std::array<int32_t, 3>>& f) {
  return make_shape({{0, 0, 0}}, f).faces;
}

TEST(Rasterize, EveryPixelOfASplitSquareOnce) {
  // The square covers the picture exactly; its diagonal runs through pixel centres.
  const at::Tensor clip = flat_clip({{-1, -1, 0}, {1, -1, 0}, {1, 1, 0}, {-1, 1, 0}});
  const at::Tensor both = faces_of({{0, 1, 2}, {0, 2, 3}});
  const at::Tensor first = rasterize(clip, faces_of({{0, 1, 2}}), 16, 16).select(-1, 3) > 0;
  const at::Tensor second = rasterize(clip, faces_of({{0, 2, 3}}), 16, 16).select(-1, 3) > 0;
  EXPECT_EQ((first & second).sum().item<int64_t>(), 0);
  EXPECT_EQ((first | second).sum().item<int64_t>(), 256);
  EXPECT_EQ((rasterize(clip, both, 16, 16).select(-1, 3) > 0).sum().item<int64_t>(), 256);
}

TEST(Rasterize, FanAroundAPixelCentreHitsEachPixelOnce) {
  // A fan whose centre vertex and several edges lie exactly on pixel centres.
  const std::vector<std::array<float, 3>> points = {
      {0.125F, 0.125F, 0}, {-1, -1, 0},    {1, -1, 0}, {1, 0.125F, 0},
      {1, 1, 0},           {0.125F, 1, 0}, {-1, 1, 0}};
  const at::Tensor clip = flat_clip(points);
  at::Tensor count = at::zeros({1, 8, 8}, at::kLong);
  for (int32_t i = 1; i <= 6; ++i) {
    const at::Tensor f = faces_of({{0, i, i % 6 + 1}});
    count += (rasterize(clip, f, 8, 8).select(-1, 3) > 0).to(at::kLong);
  }
  EXPECT_TRUE(count.eq(1).all().item<bool>()) << count;
}

TEST(Rasterize, RandomTriangulationHasNoCracksAndNoDoubleHits) {
  // A jittered grid of triangles over the picture, tested triangle by triangle.
  constexpr int kSide = 9;
  const at::Tensor jitter = testing::uniform({kSide, kSide, 2}, -0.05, 0.05, 3);
  std::vector<std::array<float, 3>> points;
  std::vector<std::array<int32_t, 3>> triangles;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const bool border = x == 0 || y == 0 || x == kSide - 1 || y == kSide - 1;
      const float dx = border ? 0.0F : jitter[y][x][0].item<float>();
      const float dy = border ? 0.0F : jitter[y][x][1].item<float>();
      points.push_back({-1.2F + 2.4F * float(x) / (kSide - 1) + dx,
                        -1.2F + 2.4F * float(y) / (kSide - 1) + dy, 0});
      if (x + 1 < kSide && y + 1 < kSide) {
        const int32_t i = y * kSide + x;
        triangles.push_back({i, i + 1, i + kSide});
        triangles.push_back({i + 1, i + kSide + 1, i + kSide});
      }
    }
  }
  const at::Tensor clip = flat_clip(points);
  at::Tensor count = at::zeros({1, 61, 47}, at::kLong);
  for (const auto& t : triangles) {
    count += (rasterize(clip, faces_of({t}), 61, 47).select(-1, 3) > 0).to(at::kLong);
  }
  EXPECT_TRUE(count.eq(1).all().item<bool>());
}

TEST(Rasterize, AgreesWithTheReferenceOnASphere) {
  const Shape shape = testing::sphere(3);
  const at::Tensor clip = perspective(shape.vertices);
  const at::Tensor rast = rasterize(clip, shape.faces, 40, 56).to(at::kDouble);
  const at::Tensor expected = testing::reference_rasterize(clip, shape.faces, 40, 56);
  const at::Tensor same = rast.select(-1, 3) == expected.select(-1, 3);
  // Pixel centres on edges may go to either triangle in the reference.
  EXPECT_GE(same.to(at::kDouble).mean().item<double>(), 0.995);
  const at::Tensor difference = (rast - expected).abs().amax(-1) * same.to(at::kDouble);
  EXPECT_LT(difference.max().item<double>(), 1e-5);
}

TEST(Rasterize, InterpolationIsPerspectiveCorrect) {
  // A square tilted away from the camera: the world position at a pixel is a ray-plane
  // intersection.
  const Shape quad =
      make_shape({{-1, -1, 1}, {1, -1, -2}, {1, 1, -2}, {-1, 1, 1}}, {{0, 1, 2}, {0, 2, 3}});
  const at::Tensor clip = perspective(quad.vertices, 1.0);
  const at::Tensor rast = rasterize(clip, quad.faces, 32, 32);
  const at::Tensor position = interpolate(quad.vertices, rast, quad.faces);
  int checked = 0;
  for (int64_t r = 0; r < 32; ++r) {
    for (int64_t c = 0; c < 32; ++c) {
      if (rast[0][r][c][3].item<float>() == 0) continue;
      const double x = (double(c) + 0.5) / 16 - 1;
      // Ray x = X / (3 - Z), plane Z = -0.5 - 1.5 X.
      const double expected = 3.5 * x / (1 - 1.5 * x);
      EXPECT_NEAR(position[0][r][c][0].item<double>(), expected, 1e-4);
      ++checked;
    }
  }
  EXPECT_GT(checked, 50);
}

TEST(Rasterize, NearerTriangleWinsWhateverTheOrder) {
  const at::Tensor clip = flat_clip({{-1, -1, 0.5F},
                                     {1, -1, 0.5F},
                                     {0, 1, 0.5F},
                                     {-1, -1, -0.5F},
                                     {1, -1, -0.5F},
                                     {0, 1, -0.5F}});
  const at::Tensor a = rasterize(clip, faces_of({{0, 1, 2}, {3, 4, 5}}), 8, 8);
  const at::Tensor b = rasterize(clip, faces_of({{3, 4, 5}, {0, 1, 2}}), 8, 8);
  EXPECT_EQ(a.select(-1, 3).max().item<float>(), 2);
  EXPECT_EQ(b.select(-1, 3).max().item<float>(), 1);
  EXPECT_EQ((a.select(-1, 3) == 1).sum().item<int64_t>(), 0);
}

TEST(Rasterize, LowerIndexWinsAtEqualDepthWhicheverIsDrawnFirst) {
  // The same triangle twice, with depths whose sums are exact. Far triangles are drawn after near
  // ones, and the first vertex decides whether a triangle is far: (a,b,c) is near here and (b,c,a)
  // far.
  const at::Tensor clip = at::tensor({-1.0F, -1.0F, -0.5F, 1.0F,  //
                                      1.0F, -1.0F, 0.5F, 1.0F,    //
                                      -1.0F, 1.0F, -0.5F, 1.0F})
                              .view({1, 3, 4});
  for (const auto& faces : {faces_of({{1, 2, 0}, {0, 1, 2}}), faces_of({{0, 1, 2}, {1, 2, 0}})}) {
    const at::Tensor shown = rasterize(clip, faces, 16, 16).select(3, 3);
    EXPECT_GT((shown == 1).sum().item<int64_t>(), 100);
    EXPECT_EQ((shown == 2).sum().item<int64_t>(), 0);
  }
}

TEST(Rasterize, ManyTrianglesShowWhatTheNearestAloneShows) {
  // Counts around the size of a batch; small triangles, large ones, some behind the camera.
  for (const int64_t count : {1, 2, 3, 5, 8, 9, 63, 64, 65, 131}) {
    at::Tensor clip = testing::uniform({1, 3 * count, 4}, -1, 1, static_cast<uint64_t>(count));
    clip.select(2, 3).add_(0.8);
    const at::Tensor faces = at::arange(3 * count, at::kInt).view({-1, 3});
    const at::Tensor together = rasterize(clip, faces, 13, 18);
    at::Tensor expected = at::zeros_like(together);
    for (int64_t i = 0; i < count; ++i) {
      at::Tensor alone = rasterize(clip, faces.slice(0, i, i + 1).contiguous(), 13, 18);
      const at::Tensor shown = expected.select(3, 3) > 0;
      const at::Tensor hides =
          (alone.select(3, 3) > 0) & (~shown | (alone.select(3, 2) < expected.select(3, 2)));
      alone.select(3, 3).mul_(static_cast<double>(i + 1));
      expected = at::where(hides.unsqueeze(3), alone, expected);
    }
    EXPECT_TRUE(at::equal(together, expected)) << count << " triangles";
  }
}

TEST(Rasterize, NastyInputsDrawNothing) {
  const float nan = std::nanf("");
  const at::Tensor clip = flat_clip(
      {{0, 0, 0}, {0.5F, 0.5F, 0}, {1, 1, 0}, {nan, 0, 0}, {0, 0, 5}, {1, 0, 5}, {0, 1, 5}});
  // Zero area; a NaN vertex; beyond the far plane.
  for (const auto& t :
       std::vector<std::array<int32_t, 3>>{{0, 1, 2}, {0, 0, 1}, {0, 3, 2}, {4, 5, 6}}) {
    EXPECT_EQ(rasterize(clip, faces_of({t}), 8, 8).abs().sum().item<float>(), 0);
  }
  at::Tensor behind = clip.clone();
  behind.select(2, 3).fill_(-1);
  EXPECT_EQ(rasterize(behind, faces_of({{0, 1, 2}}), 8, 8).abs().sum().item<float>(), 0);
}

TEST(Rasterize, TriangleThroughTheCameraPlaneShowsItsFrontPart) {
  // A ground plane triangle reaching behind the camera covers pixels below the horizon only.
  at::Tensor clip = at::tensor({-5.F, -1.F, 0.F, -1.F, 5.F, -1.F, 0.F, -1.F, 0.F, -1.F, 0.F, 9.F})
                        .view({1, 3, 4});
  const at::Tensor rast = rasterize(clip, faces_of({{0, 1, 2}}), 16, 16);
  const at::Tensor hit = rast.select(-1, 3) > 0;
  EXPECT_GT(hit.sum().item<int64_t>(), 20);
  EXPECT_EQ(hit.narrow(1, 0, 8).sum().item<int64_t>(), 0);
}

/// With few vertices a view's pixels are split into parts, with many they are not.
class Threads : public ::testing::TestWithParam<int> {};
INSTANTIATE_TEST_SUITE_P(CoarseAndFine, Threads, ::testing::Values(1, 4));

TEST_P(Threads, OneOrTwoGiveTheSameBytes) {
  const Shape shape = testing::sphere(GetParam());
  at::Tensor clip = perspective(shape.vertices);
  clip = at::cat({clip, clip * 1.1});
  const at::Tensor color = testing::uniform({2, 64, 64, 3}, 0, 1, 5).to(at::kFloat);
  const int before = at::get_num_threads();
  std::vector<at::Tensor> results;
  for (const int threads : {1, 2}) {
    at::set_num_threads(threads);
    const at::Tensor c = clip.clone().requires_grad_(true);
    const at::Tensor rast = rasterize(c, shape.faces, 64, 64);
    const at::Tensor a = shape.vertices.clone().requires_grad_(true);
    const at::Tensor p = interpolate(a, rast, shape.faces);
    const at::Tensor out = antialias(p * color, rast, c, shape.faces, edge_twins(shape.faces));
    out.square().sum().backward();
    results.push_back(at::cat({out.detach().flatten(), c.grad().flatten(), a.grad().flatten()}));
  }
  at::set_num_threads(before);
  EXPECT_TRUE(at::equal(results[0], results[1]));
}

TEST(EdgeTwins, ClosedOpenAndNonManifold) {
  const Shape closed = testing::sphere(1);
  const at::Tensor twins = edge_twins(closed.faces).flatten().to(at::kLong);
  ASSERT_GE(twins.min().item<int64_t>(), 0);
  EXPECT_TRUE(at::equal(twins.index_select(0, twins), at::arange(twins.numel())));
  const at::Tensor open = edge_twins(faces_of({{0, 1, 2}, {2, 1, 3}}));
  EXPECT_EQ(open[0][0].item<int32_t>(), 3 * 1 + 2);  // edge 1-2 is opposite vertex 3
  EXPECT_EQ(open[1][2].item<int32_t>(), 0);
  EXPECT_EQ(open[0][1].item<int32_t>(), -1);
  const at::Tensor fin = edge_twins(faces_of({{0, 1, 2}, {2, 1, 3}, {1, 2, 4}}));
  EXPECT_EQ(fin[0][0].item<int32_t>(), -1);
}

TEST(Antialias, SilhouettesDoNotDependOnOrientation) {
  // The same sphere with every third face turned around.
  const Shape shape = testing::sphere(1, 0.9F);
  at::Tensor mixed = shape.faces.clone();
  mixed.slice(0, 0, mixed.size(0), 3).copy_(shape.faces.slice(0, 0, mixed.size(0), 3).flip(1));
  const at::Tensor clip = perspective(shape.vertices);
  const auto draw = [&](const at::Tensor& faces) {
    const at::Tensor rast = rasterize(clip, faces, 64, 64);
    const at::Tensor alpha = (rast.narrow(3, 3, 1) > 0).to(at::kFloat);
    return antialias(alpha, rast, clip, faces, edge_twins(faces));
  };
  const at::Tensor plain = draw(shape.faces.contiguous());
  EXPECT_GT((plain.gt(0) & plain.lt(1)).sum().item<int64_t>(), 20);
  EXPECT_TRUE(at::allclose(plain, draw(mixed.contiguous())));
}

TEST(Antialias, CoverageOfAHalfPlaneIsItsArea) {
  // A rectangle whose right side crosses a pixel column at a known fraction.
  for (const double share : {0.1, 0.3, 0.5, 0.7, 0.9}) {
    const auto right = static_cast<float>((4 + share) / 4.0 - 1);
    const at::Tensor clip = flat_clip({{-3, -3, 0}, {right, -3, 0}, {right, 3, 0}, {-3, 3, 0}});
    const at::Tensor faces = faces_of({{0, 1, 2}, {0, 2, 3}});
    const at::Tensor rast = rasterize(clip, faces, 8, 8);
    const at::Tensor alpha = (rast.narrow(-1, 3, 1) > 0).to(at::kFloat);
    const at::Tensor out = antialias(alpha, rast, clip, faces, edge_twins(faces));
    EXPECT_NEAR(out[0][4][4][0].item<double>(), share, 1e-5);
    EXPECT_NEAR(out[0][4][3][0].item<double>(), 1, 1e-6);
    EXPECT_NEAR(out[0][4][5][0].item<double>(), 0, 1e-6);
  }
}

TEST(Antialias, InnerEdgesStaySharp) {
  const Shape shape = testing::sphere(2);
  const at::Tensor clip = perspective(shape.vertices);
  const at::Tensor rast = rasterize(clip, shape.faces, 48, 48);
  const at::Tensor color = rast.narrow(-1, 3, 1).contiguous();
  const at::Tensor out = antialias(color, rast, clip, shape.faces, edge_twins(shape.faces));
  // Well inside the disc nothing changes, although triangles differ from pixel to pixel.
  EXPECT_TRUE(at::equal(out.narrow(1, 18, 12).narrow(2, 18, 12),
                        color.narrow(1, 18, 12).narrow(2, 18, 12)));
  EXPECT_FALSE(at::equal(out, color));
}

TEST(Texture, BilinearBetweenTexelCentres) {
  const at::Tensor texels = at::arange(16, at::kFloat).view({4, 4, 1});
  const at::Tensor rast = at::ones({1, 1, 3, 4});
  const at::Tensor uv = at::tensor({0.375F, 0.125F, 0.5F, 0.125F, 0.5F, 0.5F}).view({1, 1, 3, 2});
  const at::Tensor out = texture(texels, uv, at::Tensor(), rast).flatten();
  EXPECT_NEAR(out[0].item<float>(), 1, 1e-6);
  EXPECT_NEAR(out[1].item<float>(), 1.5, 1e-6);
  EXPECT_NEAR(out[2].item<float>(), 7.5, 1e-6);
}

TEST(Texture, DistantCheckerboardIsGrey) {
  at::Tensor texels = at::zeros({64, 64, 1});
  for (int64_t y = 0; y < 64; ++y) {
    for (int64_t x = 0; x < 64; ++x) texels[y][x] = float((x + y) % 2);
  }
  const at::Tensor rast = at::ones({1, 4, 4, 4});
  const at::Tensor uv = testing::uniform({1, 4, 4, 2}, 0, 1, 1).to(at::kFloat);
  at::Tensor derivatives = at::zeros({1, 4, 4, 4});
  derivatives.select(-1, 0).fill_(0.25);
  derivatives.select(-1, 3).fill_(0.25);
  const at::Tensor out = texture(texels, uv, derivatives, rast);
  EXPECT_LT((out - 0.5).abs().max().item<float>(), 1e-6);
}

}  // namespace
}  // namespace tt3d::raster
