#include <gtest/gtest.h>

#include "raster/raster_reference.h"
#include "support/gradient_check.h"
#include "support/shapes.h"
#include "tt3d/raster.h"

namespace tt3d::raster {
namespace {

using testing::gradient_error;
using testing::uniform;

/// A few overlapping triangles at different depths in front of a perspective camera, float64.
at::Tensor scene_clip() {
  at::Tensor clip = uniform({2, 9, 4}, -1, 1, 11);
  clip.select(2, 3).copy_(uniform({2, 9}, 0.9, 1.6, 12));
  clip.select(2, 2).mul_(0.5);
  return clip;
}

at::Tensor scene_faces() { return at::arange(9, at::kInt).view({3, 3}).contiguous(); }

constexpr int64_t kSize = 14;

TEST(RasterGradient, BarycentricsAgainstCentralDifferences) {
  const at::Tensor faces = scene_faces();
  const at::Tensor fixed = rasterize(scene_clip(), faces, kSize, kSize);
  const at::Tensor weight = uniform({2, kSize, kSize, 2}, -1, 1, 13);
  // u and v are discontinuous at a pixel whose triangle changes under the step. No pixel does so
  // here: the index stays constant.
  const double error = gradient_error(
      [&](const std::vector<at::Tensor>& in) {
        const at::Tensor rast = rasterize(in[0], faces, kSize, kSize);
        EXPECT_TRUE(at::equal(rast.select(-1, 3), fixed.select(-1, 3)));
        return (rast.narrow(-1, 0, 2) * weight).sum();
      },
      {scene_clip()}, 1e-7);
  EXPECT_LT(error, 1e-5);
}

TEST(RasterGradient, BarycentricsAgainstTensorReference) {
  const at::Tensor faces = scene_faces();
  const at::Tensor weight = uniform({2, kSize, kSize, 2}, -1, 1, 13);
  at::Tensor a = scene_clip().requires_grad_(true);
  at::Tensor b = scene_clip().requires_grad_(true);
  const at::Tensor rast = rasterize(a, faces, kSize, kSize);
  const at::Tensor reference = testing::reference_barycentrics(b, rast.detach(), faces);
  EXPECT_LT((rast.narrow(-1, 0, 2) - reference).abs().max().item<double>(), 1e-9);
  (rast.narrow(-1, 0, 2) * weight).sum().backward();
  (reference * weight).sum().backward();
  EXPECT_LT((a.grad() - b.grad()).abs().max().item<double>(),
            1e-8 * b.grad().abs().max().item<double>());
  EXPECT_GT(testing::cosine(a.grad(), b.grad()), 1 - 1e-12);
}

TEST(RasterGradient, InterpolateAgainstCentralDifferences) {
  const at::Tensor faces = scene_faces();
  const at::Tensor rast = rasterize(scene_clip(), faces, kSize, kSize);
  const at::Tensor weight = uniform({2, kSize, kSize, 3}, -1, 1, 14);
  const double error = gradient_error(
      [&](const std::vector<at::Tensor>& in) {
        const at::Tensor r = at::cat({in[1], rast.narrow(-1, 2, 2)}, -1);
        return (interpolate(in[0], r, faces).sin() * weight).sum();
      },
      {uniform({9, 3}, -1, 1, 15), rast.narrow(-1, 0, 2)});
  EXPECT_LT(error, 1e-6);
}

TEST(RasterGradient, InterpolateOfAnyWidthAgainstTensorReference) {
  const at::Tensor faces = scene_faces();
  const at::Tensor rast = rasterize(scene_clip(), faces, kSize, kSize);
  const at::Tensor shown = rast.select(-1, 3).to(at::kLong) - 1;
  const at::Tensor weights =
      at::cat({rast.narrow(-1, 0, 2), 1 - rast.narrow(-1, 0, 2).sum(-1, true)}, -1);
  for (int64_t channels = 1; channels <= 6; ++channels) {
    const at::Tensor weight = uniform({2, kSize, kSize, channels}, -1, 1, 14);
    const at::Tensor a = uniform({9, channels}, -1, 1, 15).requires_grad_(true);
    const at::Tensor b = a.detach().clone().requires_grad_(true);
    const at::Tensor corners = b.index_select(
        0, faces.to(at::kLong).index_select(0, shown.clamp_min(0).flatten()).flatten());
    const at::Tensor blended =
        (corners.view({2, kSize, kSize, 3, channels}) * weights.unsqueeze(-1)).sum(3);
    (interpolate(a, rast, faces) * weight).sum().backward();
    (blended * (shown >= 0).unsqueeze(-1) * weight).sum().backward();
    EXPECT_LT((a.grad() - b.grad()).abs().max().item<double>(), 1e-12) << channels;
  }
}

TEST(RasterGradient, PaintedPixelsAgainstCentralDifferences) {
  const at::Tensor pixels = at::tensor({7, 2, 11, 0}, at::kLong);
  for (const int64_t channels : {3, 6}) {
    const at::Tensor colors = testing::uniform({channels, 4}, 0, 1, 41);
    // Plain tensor operations: rows of colours, alpha in the fourth column.
    const at::Tensor rows = colors.t();
    const at::Tensor shown = at::cat(
        {rows.narrow(1, 0, 3), at::ones({4, 1}, rows.options()), rows.narrow(1, 3, channels - 3)},
        1);
    const at::Tensor expected =
        at::zeros({12, channels + 1}, rows.options()).index_copy(0, pixels, shown);
    EXPECT_TRUE(at::equal(paint_pixels(colors, pixels, 12), expected));
    const at::Tensor weight = testing::uniform({12, channels + 1}, -1, 1, 42);
    EXPECT_LT(testing::gradient_error(
                  [&](const auto& in) {
                    return (paint_pixels(in[0], pixels, 12).square() * weight).sum();
                  },
                  {colors}),
              1e-7);
  }
  EXPECT_THROW((void)paint_pixels(at::zeros({2, 4}), pixels, 12), c10::Error);
  EXPECT_THROW((void)paint_pixels(at::zeros({3, 5}), pixels, 12), c10::Error);
}

TEST(RasterGradient, AntialiasAgainstCentralDifferences) {
  const at::Tensor faces = scene_faces();
  const at::Tensor twins = edge_twins(faces);
  const at::Tensor weight = uniform({2, kSize, kSize, 2}, -1, 1, 16);
  // Coverage is frozen: only the crossing positions carry the gradient, as documented.
  const at::Tensor rast = rasterize(scene_clip(), faces, kSize, kSize);
  const double error = gradient_error(
      [&](const std::vector<at::Tensor>& in) {
        return (antialias(in[0], rast, in[1], faces, twins).square() * weight).sum();
      },
      {uniform({2, kSize, kSize, 2}, 0, 1, 17), scene_clip()}, 1e-7);
  EXPECT_LT(error, 1e-5);
}

TEST(RasterGradient, AreaOfADiscFollowsItsRadius) {
  // d(area)/d(radius) of an antialiased disc is its circumference; the silhouette gradient must
  // give it.
  const testing::Shape shape = testing::sphere(4);
  const at::Tensor twins = edge_twins(shape.faces);
  at::Tensor radius = at::full({}, 0.7, at::kDouble).requires_grad_(true);
  const at::Tensor v = shape.vertices.to(at::kDouble) * radius;
  const at::Tensor clip =
      at::cat({v.narrow(1, 0, 2), v.narrow(1, 2, 1) * -0.5, at::ones({v.size(0), 1}, at::kDouble)},
              1)
          .unsqueeze(0);
  constexpr int64_t kPixels = 96;
  const at::Tensor rast = rasterize(clip, shape.faces, kPixels, kPixels);
  const at::Tensor alpha = (rast.narrow(-1, 3, 1) > 0).to(at::kDouble);
  const at::Tensor area =
      antialias(alpha, rast, clip, shape.faces, twins).sum() * (4.0 / (kPixels * kPixels));
  EXPECT_NEAR(area.item<double>(), 3.14159 * 0.49, 0.01);
  area.backward();
  EXPECT_NEAR(radius.grad().item<double>(), 2 * 3.14159 * 0.7, 0.25);
}

TEST(RasterGradient, TextureAgainstCentralDifferences) {
  const at::Tensor rast = at::ones({1, 5, 5, 4}, at::kDouble);
  const at::Tensor weight = uniform({1, 5, 5, 2}, -1, 1, 18);
  const at::Tensor derivatives = uniform({1, 5, 5, 4}, -0.3, 0.3, 19);
  const auto loss = [&](const at::Tensor& d) {
    return [&weight, &rast, d](const std::vector<at::Tensor>& in) {
      return (texture(in[0], in[1], d, rast).square() * weight).sum();
    };
  };
  const std::vector<at::Tensor> inputs = {uniform({8, 8, 2}, 0, 1, 20),
                                          uniform({1, 5, 5, 2}, 0.1, 0.9, 21)};
  EXPECT_LT(gradient_error(loss(derivatives), inputs), 1e-5);
  EXPECT_LT(gradient_error(loss(at::Tensor()), inputs), 1e-5);
}

TEST(RasterGradient, AttributeDerivativesAgainstNeighbouringPixels) {
  // An affine attribute on a plane facing the camera has constant derivatives.
  at::Tensor clip = at::tensor({-1., -1., 0., 1., 1., -1., 0., 1., 0., 1., 0., 1.}).view({1, 3, 4});
  const at::Tensor faces = at::arange(3, at::kInt).view({1, 3});
  const at::Tensor attributes = uniform({3, 2}, 0, 1, 22);
  const at::Tensor rast = rasterize(clip.to(at::kDouble), faces, 16, 16);
  const at::Tensor value = interpolate(attributes, rast, faces);
  const at::Tensor d = attribute_derivatives(attributes, rast, clip.to(at::kDouble), faces);
  const at::Tensor right = value[0][12][8] - value[0][12][7];
  const at::Tensor down = value[0][12][8] - value[0][11][8];
  for (int64_t c = 0; c < 2; ++c) {
    EXPECT_NEAR(d[0][12][8][2 * c].item<double>(), right[c].item<double>(), 1e-9);
    EXPECT_NEAR(d[0][12][8][2 * c + 1].item<double>(), down[c].item<double>(), 1e-9);
  }
}

}  // namespace
}  // namespace tt3d::raster
