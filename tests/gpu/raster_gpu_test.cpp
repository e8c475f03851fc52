#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "gpu/both_devices.h"
#include "tt3d/raster.h"

namespace tt3d {
namespace {

using at::Tensor;
using testing::expect_same;
using testing::uniform;

struct RasterOnGpu : testing::OnGpu {};

/// A scene for the rasterizer, float64.
struct Scene {
  std::string name;
  Tensor clip;   ///< [N,V,4]
  Tensor faces;  ///< [F,3]
  int64_t height, width;
};

Tensor perspective(const Tensor& vertices, double distance) {
  const Tensor depth = distance - vertices.select(1, 2);
  const double near = 0.5, far = 10;
  const Tensor z = depth * ((far + near) / (far - near)) - 2 * far * near / (far - near);
  return at::stack({vertices.select(1, 0) * 1.8, vertices.select(1, 1) * 1.8, z, depth}, 1)
      .unsqueeze(0);
}

Scene sphere_scene(const std::string& name, int levels, double distance, int64_t size) {
  const testing::Shape shape = testing::sphere(levels);
  return {name, perspective(shape.vertices.to(at::kDouble), distance), shape.faces, size, size};
}

Scene random_triangles(const std::string& name, int64_t triangles, double w_low, int64_t height,
                       int64_t width) {
  Tensor clip = uniform({3, 3 * triangles, 4}, -1, 1, 21);
  clip.select(2, 3).copy_(uniform({3, 3 * triangles}, w_low, 1.6, 22));
  return {name, clip, at::arange(3 * triangles, at::kInt).view({triangles, 3}).contiguous(), height,
          width};
}

/// A square of triangles with shared edges; their diagonals and corners lie on pixel centres.
Scene shared_edges() {
  std::vector<double> points;
  std::vector<int32_t> faces;
  constexpr int kSide = 9;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      points.insert(points.end(), {-1.0 + (x + 0.5) / 8, -1.0 + (y + 0.5) / 8, 0.25, 1.0});
      if (x + 1 == kSide || y + 1 == kSide) continue;
      const int32_t i = y * kSide + x;
      faces.insert(faces.end(), {i, i + 1, i + kSide, i + 1, i + kSide + 1, i + kSide});
    }
  }
  return {"shared edges", at::tensor(points, at::kDouble).view({1, -1, 4}),
          at::tensor(faces, at::kInt).view({-1, 3}), 16, 16};
}

/// Equal depths, zero area, repeated vertices, non-finite values.
Scene degenerate() {
  Tensor clip = uniform({1, 12, 4}, -1, 1, 23);
  clip.select(2, 3).fill_(1);
  clip.select(2, 2).fill_(0.5);
  clip[0][9][0] = std::nan("");
  clip[0][10][1] = std::numeric_limits<double>::infinity();
  clip[0][11] = 0;
  const std::vector<int32_t> faces = {0, 1, 2, 0, 1, 2, 2,  1, 0, 3,  3, 4, 5, 5,
                                      5, 6, 7, 9, 6, 7, 10, 6, 7, 11, 3, 4, 8};
  return {"degenerate", clip, at::tensor(faces, at::kInt).view({-1, 3}), 33, 29};
}

std::vector<Scene> scenes() {
  std::vector<Scene> all = {shared_edges(), degenerate()};
  all.push_back(sphere_scene("sphere", 4, 3, 96));
  all.push_back(sphere_scene("camera inside the sphere", 3, 0.2, 64));
  all.push_back(random_triangles("random", 40, 0.5, 61, 47));
  all.push_back(random_triangles("through the camera plane", 12, -1.2, 40, 56));
  Scene behind = random_triangles("behind the camera", 20, 0.5, 32, 32);
  behind.clip.select(2, 3).neg_();
  all.push_back(behind);
  Scene outside = random_triangles("an empty frame", 20, 0.5, 32, 32);
  outside.clip.select(2, 0).add_(50);
  all.push_back(outside);
  Scene huge = random_triangles("huge triangles", 3, 0.5, 512, 512);
  huge.clip.narrow(2, 0, 2).mul_(1e5);
  all.push_back(huge);
  Scene none = random_triangles("no triangles", 1, 0.5, 8, 8);
  none.faces = none.faces.narrow(0, 0, 0).contiguous();
  all.push_back(none);
  all.push_back(random_triangles("one pixel", 5, 0.5, 1, 1));
  return all;
}

Tensor shown(const Scene& s, const Tensor& clip) {
  return raster::rasterize(clip, s.faces.to(clip.device()), s.height, s.width);
}

TEST_F(RasterOnGpu, RasterizeShowsTheSameBytes) {
  for (const Scene& s : scenes()) {
    for (const auto dtype : {at::kFloat, at::kDouble}) {
      const Tensor clip = s.clip.to(dtype);
      EXPECT_TRUE(at::equal(shown(s, clip), shown(s, clip.to(gpu)).cpu())) << s.name;
    }
  }
}

TEST_F(RasterOnGpu, AMeshOfHalfAMillionFacesShowsTheSameBytes) {
  const Scene s = sphere_scene("large", 8, 3, 2048);
  const Tensor clip = s.clip.to(at::kFloat);
  EXPECT_TRUE(at::equal(shown(s, clip), shown(s, clip.to(gpu)).cpu()));
}

TEST_F(RasterOnGpu, RasterizeGivesTheSameBytesEachTime) {
  const Scene s = random_triangles("random", 500, 0.5, 128, 128);
  const Tensor clip = s.clip.to(gpu);
  const Tensor first = shown(s, clip);
  for (int i = 0; i < 5; ++i) EXPECT_TRUE(at::equal(first, shown(s, clip)));
}

/// Scenes without non-finite values, which gradients would propagate.
std::vector<Scene> finite_scenes() {
  std::vector<Scene> finite;
  for (Scene& s : scenes()) {
    if (s.clip.isfinite().all().item<bool>()) finite.push_back(std::move(s));
  }
  return finite;
}

TEST_F(RasterOnGpu, RasterizeGradients) {
  for (const Scene& s : finite_scenes()) {
    expect_same(
        s.name, gpu, [&](const auto& in) { return shown(s, in[0]).narrow(-1, 0, 2); }, {s.clip},
        1e-9);
    expect_same(
        s.name, gpu, [&](const auto& in) { return shown(s, in[0]).narrow(-1, 0, 2); },
        {s.clip.to(at::kFloat)}, 1e-3);
  }
}

TEST_F(RasterOnGpu, InterpolateAndItsGradients) {
  for (const Scene& s : finite_scenes()) {
    const Tensor attributes = uniform({s.clip.size(1), 3}, -1, 1, 31);
    const Tensor rast = shown(s, s.clip);
    for (const auto& [dtype, tolerance] :
         {std::pair{at::kDouble, 1e-11}, std::pair{at::kFloat, 1e-4}}) {
      expect_same(
          s.name, gpu,
          [&](const auto& in) {
            return raster::interpolate(in[0], in[1], s.faces.to(in[0].device()));
          },
          {attributes.to(dtype), rast.to(dtype)}, tolerance);
    }
  }
}

TEST_F(RasterOnGpu, PaintedPixelsAndTheirGradients) {
  const Tensor pixels = at::randperm(5000, at::kLong).narrow(0, 0, 2000).contiguous();
  expect_same(
      "paint_pixels", gpu,
      [&](const auto& in) { return raster::paint_pixels(in[0], pixels.to(in[0].device()), 5000); },
      {uniform({6, 2000}, 0, 1, 38)}, 0);
}

TEST_F(RasterOnGpu, AttributeDerivatives) {
  for (const Scene& s : finite_scenes()) {
    const Tensor attributes = uniform({s.clip.size(1), 2}, -1, 1, 32);
    const Tensor rast = shown(s, s.clip);
    const Tensor a = raster::attribute_derivatives(attributes, rast, s.clip, s.faces);
    const Tensor b = raster::attribute_derivatives(attributes.to(gpu), rast.to(gpu), s.clip.to(gpu),
                                                   s.faces.to(gpu));
    EXPECT_LE(testing::relative_difference(a, b), 1e-12) << s.name;
  }
}

TEST_F(RasterOnGpu, AntialiasAndItsGradients) {
  for (const Scene& s : finite_scenes()) {
    const Tensor twins = raster::edge_twins(s.faces);
    const Tensor rast = shown(s, s.clip);
    const Tensor color = uniform({rast.size(0), s.height, s.width, 4}, 0, 1, 33);
    for (const auto& [dtype, tolerance] :
         {std::pair{at::kDouble, 1e-9}, std::pair{at::kFloat, 1e-3}}) {
      const Tensor fixed = shown(s, s.clip.to(dtype));
      expect_same(
          s.name, gpu,
          [&](const auto& in) {
            const at::Device device = in[0].device();
            return raster::antialias(in[0], fixed.to(device), in[1], s.faces.to(device),
                                     twins.to(device));
          },
          {color.to(dtype), s.clip.to(dtype)}, tolerance);
    }
  }
}

TEST_F(RasterOnGpu, EdgeOppositesStayOnTheDevice) {
  const testing::Shape shape = testing::sphere(2);
  const Tensor b = raster::edge_twins(shape.faces.to(gpu));
  EXPECT_EQ(b.device(), gpu);
  EXPECT_TRUE(at::equal(raster::edge_twins(shape.faces), b.cpu()));
}

TEST_F(RasterOnGpu, TextureAndItsGradients) {
  const Tensor rast = (uniform({2, 19, 23, 4}, 0, 1, 34) > 0.3).to(at::kDouble);
  const Tensor uv = uniform({2, 19, 23, 2}, -1.5, 2.5, 35);  // wraps
  const Tensor derivatives = uniform({2, 19, 23, 4}, -0.4, 0.4, 36);
  for (const auto& [dtype, tolerance] :
       {std::pair{at::kDouble, 1e-10}, std::pair{at::kFloat, 1e-4}}) {
    for (const bool mipmaps : {false, true}) {
      expect_same(
          mipmaps ? "mipmaps" : "one level", gpu,
          [&](const auto& in) {
            const Tensor d = mipmaps ? derivatives.to(in[1].options()) : Tensor();
            return raster::texture(in[0], in[1], d, rast.to(in[1].options()));
          },
          {uniform({64, 32, 3}, 0, 1, 37).to(dtype), uv.to(dtype)}, tolerance);
    }
  }
}

TEST_F(RasterOnGpu, TensorsOnTwoDevicesAreRefused) {
  const Scene s = shared_edges();
  EXPECT_THROW((void)raster::rasterize(s.clip.to(gpu), s.faces, 8, 8), c10::Error);
}

}  // namespace
}  // namespace tt3d
