#include "tt3d/eot.h"
#include "tt3d/image.h"
#include "tt3d/scene.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "attack/picture_ops.h"
#include "attack/toy_attack.h"
#include "support/gradient_check.h"
#include "support/shapes.h"
#include "support/temporary_folder.h"
#include "tt3d/attack.h"

namespace tt3d::attack {
namespace {

using at::Tensor;
using testing::no_transforms;
using testing::value;

TEST(Eot, PaddingIsBackgroundAndNeverBlack) {
  // A fully transparent rendering gives the background alone, for any placement.
  EotOptions o;
  o.brightness = o.contrast = o.saturation = o.noise = o.plain_background = 0;
  const Tensor out = transform_images(at::zeros({4, 4, 20, 20}), 24, o, 1, 0);
  EXPECT_NEAR(out.min().item<double>(), 1, 1e-6);
}

TEST(Eot, PhotographsStandBehindTheObject) {
  testing::TemporaryFolder folder;
  write_file_atomic(folder / "a.png", image::encode_png(at::full({6, 9, 3}, 51, at::kByte)));
  const scene::Backgrounds photographs(folder.path().string());
  EotOptions o;
  o.brightness = o.contrast = o.saturation = o.noise = o.plain_background = 0;
  o.photograph_background = 1;
  const Tensor out = transform_images(at::zeros({2, 4, 20, 20}), 24, o, 1, 0, &photographs);
  EXPECT_LT((out - 0.2).abs().max().item<double>(), 1e-4);
}

TEST(Eot, IsTheIdentityIfEveryRangeIsZero) {
  Tensor x = testing::uniform({2, 4, 16, 16}, 0, 1, 3).to(at::kFloat);
  x.select(1, 3).fill_(1);
  const Tensor out = transform_images(x, 16, no_transforms(), 1, 0);
  EXPECT_LT(value((out - x.narrow(1, 0, 3)).abs().max()), 1e-5);
}

/// Every transform with its name and a function that turns it on.
std::vector<std::pair<std::string, std::function<void(EotOptions&)>>> switches() {
  return {{"scale", [](EotOptions& o) { o.scale_low = 0.5; }},
          {"shift", [](EotOptions& o) { o.shift = 0.3; }},
          {"rotation", [](EotOptions& o) { o.rotation_deg = 45; }},
          {"plain_background", [](EotOptions& o) { o.plain_background = 1; }},
          {"brightness", [](EotOptions& o) { o.brightness = 0.5; }},
          {"contrast", [](EotOptions& o) { o.contrast = 0.5; }},
          {"saturation", [](EotOptions& o) { o.saturation = 0.5; }},
          {"blur", [](EotOptions& o) { o.blur = 3; }},
          {"resolution", [](EotOptions& o) { o.resolution = 0.2; }},
          {"noise", [](EotOptions& o) { o.noise = 0.2; }},
          {"diversity", [](EotOptions& o) { o.diversity = 1; }},
          {"jpeg", [](EotOptions& o) { o.jpeg = 1, o.jpeg_quality_low = 5; }}};
}

TEST(Eot, EachTransformChangesThePictureAndDependsOnTheStep) {
  const Tensor x = testing::uniform({1, 4, 16, 16}, 0, 0.8, 3).to(at::kFloat);
  const Tensor base = transform_images(x, 16, no_transforms(), 1, 0);
  for (const auto& [name, switch_on] : switches()) {
    EotOptions o = no_transforms();
    switch_on(o);
    const Tensor a = transform_images(x, 16, o, 1, 1);
    EXPECT_FALSE(at::equal(a, base)) << name;
    EXPECT_FALSE(at::equal(a, transform_images(x, 16, o, 1, 2))) << name;
    EXPECT_TRUE(at::equal(a, transform_images(x, 16, o, 1, 1))) << name;
  }
}

TEST(Eot, TransformsWithTheirOwnStreamKeepTheDrawsOfTheOthers) {
  // With jpeg and resolution on but without effect, the result does not change.
  const Tensor x = testing::uniform({3, 4, 16, 16}, 0, 0.8, 3).to(at::kFloat);
  EotOptions o;
  const Tensor before = transform_images(x, 16, o, 1, 1);
  o.resolution = 0.999;
  o.jpeg = 1e-9;
  EXPECT_TRUE(at::allclose(transform_images(x, 16, o, 1, 1), before, 0, 1e-5));
}

// ---- Distributions ------------------------------------------------------------------------

/// Checks that draws are uniform in [low, high]: bounds, values near both ends, mean and variance.
void expect_uniform(const Tensor& draws, double low, double high, const std::string& what) {
  const double width = high - low, n = static_cast<double>(draws.numel());
  const Tensor x = draws.to(at::kDouble);
  EXPECT_GE(value(x.min()), low - 0.04 * width) << what;
  EXPECT_LE(value(x.max()), high + 0.04 * width) << what;
  EXPECT_LE(value(x.min()), low + 0.1 * width) << what;
  EXPECT_GE(value(x.max()), high - 0.1 * width) << what;
  EXPECT_NEAR(value(x.mean()), (low + high) / 2, 4 * width / std::sqrt(12 * n)) << what;
  EXPECT_NEAR(value(x.var()), width * width / 12, 0.25 * width * width / 12) << what;
}

constexpr int64_t kDraws = 300, kSide = 32;

/// An opaque square of one colour, `half` pixels in each direction around (row, column), over
/// white.
Tensor squares(int64_t count, double red, double green, double blue, int64_t half = 6) {
  Tensor x = at::zeros({count, 4, kSide, kSide});
  const auto patch = x.narrow(2, kSide / 2 - half, 2 * half).narrow(3, kSide / 2 - half, 2 * half);
  patch.copy_(at::tensor({red, green, blue, 1.0}).view({1, 4, 1, 1}));
  return x;
}

/// Darkness of transformed black squares: [N,S,S].
Tensor darkness(const EotOptions& o) {
  return 1 - transform_images(squares(kDraws, 0, 0, 0), kSide, o, 7, 0).mean(1);
}

/// Centroid of the darkness along x (dim 2) or y (dim 1), in pixels from the centre.
Tensor centroid(const Tensor& dark, int64_t dim) {
  const Tensor axis = at::arange(kSide) + 0.5 - kSide / 2.0;
  const Tensor along = dark.sum(3 - dim);
  return (along * axis).sum(1) / along.sum(1);
}

TEST(EotDistribution, ScaleShiftAndRotation) {
  EotOptions o = no_transforms();
  o.scale_low = 0.6;
  o.scale_high = 1.2;
  expect_uniform(darkness(o).sum({1, 2}).sqrt() / 12, 0.6, 1.2, "scale");

  o = no_transforms();
  o.shift = 0.15;
  const Tensor shifted = darkness(o);
  expect_uniform(centroid(shifted, 2), -0.15 * kSide, 0.15 * kSide, "shift along x");
  expect_uniform(centroid(shifted, 1), -0.15 * kSide, 0.15 * kSide, "shift along y");

  // The direction of a bar across the frame, from its second moments.
  o = no_transforms();
  o.rotation_deg = 40;
  Tensor bar = at::zeros({kDraws, 4, kSide, kSide});
  bar.narrow(2, 14, 4).narrow(3, 6, 20).select(1, 3).fill_(1);
  const Tensor dark = 1 - transform_images(bar, kSide, o, 7, 0).mean(1);
  const Tensor axis = at::arange(kSide) + 0.5 - kSide / 2.0;
  const Tensor xx = (dark * axis.square().view({1, 1, -1})).sum({1, 2});
  const Tensor yy = (dark * axis.square().view({1, -1, 1})).sum({1, 2});
  const Tensor xy = (dark * axis.view({1, 1, -1}) * axis.view({1, -1, 1})).sum({1, 2});
  const Tensor degrees = at::atan2(2 * xy, xx - yy) / 2 * (180 / M_PI);
  expect_uniform(degrees, -40, 40, "rotation");
}

/// Colour at the centre of transformed squares, [N,3].
Tensor middles(const EotOptions& o, double red, double green, double blue) {
  const Tensor x = squares(kDraws, red, green, blue, kSide / 2);
  return transform_images(x, kSide, o, 7, 0).select(3, kSide / 2).select(2, kSide / 2);
}

TEST(EotDistribution, BrightnessContrastAndSaturation) {
  EotOptions o = no_transforms();
  o.brightness = 0.3;
  expect_uniform(middles(o, 0.5, 0.5, 0.5).select(1, 0) / 0.5, 0.7, 1.3, "brightness");

  // Half of the picture is 0.4 and half is 0.6, so their difference is the factor times 0.2.
  o = no_transforms();
  o.contrast = 0.3;
  Tensor halves = squares(kDraws, 0.4, 0.4, 0.4, kSide / 2);
  halves.narrow(1, 0, 3).narrow(3, 0, kSide / 2).fill_(0.6);
  const Tensor x = transform_images(halves, kSide, o, 7, 0);
  expect_uniform((x.select(3, 4) - x.select(3, kSide - 4)).mean({1, 2}) / 0.2, 0.7, 1.3,
                 "contrast");

  o = no_transforms();
  o.saturation = 0.3;
  const Tensor color = middles(o, 0.6, 0.4, 0.4);
  expect_uniform((color.select(1, 0) - color.select(1, 1)) / 0.2, 0.7, 1.3, "saturation");
}

/// A figure of many steps, with one picture per step.
Tensor over_steps(const std::function<double(int64_t)>& figure) {
  std::vector<double> figures;
  for (int64_t step = 0; step < kDraws; ++step) figures.push_back(figure(step));
  return at::tensor(figures, at::kDouble);
}

TEST(EotDistribution, BlurResolutionAndNoise) {
  // A blurred step edge: the variance of its slope is sigma squared.
  EotOptions o = no_transforms();
  o.blur = 3;
  Tensor edge = squares(1, 0, 0, 0, kSide / 2);
  edge.narrow(1, 0, 3).narrow(3, kSide / 2, kSide / 2).fill_(1);
  const Tensor axis = at::arange(kSide - 1) + 1.0 - kSide / 2.0;
  const Tensor sigma = over_steps([&](int64_t step) {
    const Tensor row = transform_images(edge, kSide, o, 7, step)[0][0][kSide / 2];
    return value(((row.diff() * axis.square()).sum() / row.diff().sum()).sqrt());
  });
  // The kernel ends at two sigma, which lowers the measured sigma by a tenth. Below 0.2 pixels
  // there is no blur.
  EXPECT_LT(value(sigma.max()), 3);
  EXPECT_GT(value(sigma.max()), 2.4);
  EXPECT_LT(value(sigma.min()), 0.1);
  EXPECT_NEAR(value(sigma.mean()), 0.88 * 1.5, 0.15);

  // Stripes of one pixel vanish if the resolution is below one half.
  o = no_transforms();
  o.resolution = 0.25;
  Tensor stripes = squares(1, 0, 0, 0, kSide / 2);
  stripes.narrow(1, 0, 3).copy_((at::arange(kSide) % 2).view({1, 1, 1, -1}));
  const Tensor left = over_steps(
      [&](int64_t step) { return value(transform_images(stripes, kSide, o, 7, step).std()); });
  EXPECT_LT(value(left.max()), 0.52);
  EXPECT_GT(value(left.max()), 0.3);
  EXPECT_LT(value(left.median()), 0.2);

  o = no_transforms();
  o.noise = 0.1;
  const Tensor grey = squares(1, 0.5, 0.5, 0.5, kSide / 2);
  const Tensor spread = over_steps(
      [&](int64_t step) { return value(transform_images(grey, kSide, o, 7, step).std()); });
  expect_uniform(spread, 0, 0.1, "noise");
}

TEST(EotDistribution, SharesOfBackgroundsAndJpeg) {
  EotOptions o = no_transforms();
  o.plain_background = 0.3;
  const Tensor behind = transform_images(at::zeros({kDraws, 4, 8, 8}), 8, o, 7, 0);
  const Tensor plain = (behind.mean({1, 2, 3}) < 0.999);
  EXPECT_NEAR(value(plain.to(at::kDouble).mean()), 0.3, 0.1);
  const Tensor colors = behind.index_select(0, plain.nonzero().flatten()).select(3, 0).select(2, 0);
  expect_uniform(colors.flatten(), 0, 1, "plain colours");

  o = no_transforms();
  o.jpeg = 0.4;
  o.jpeg_quality_low = o.jpeg_quality_high = 10;
  Tensor x = testing::uniform({kDraws, 4, 16, 16}, 0, 1, 3).to(at::kFloat);
  x.select(1, 3).fill_(1);
  const Tensor change =
      (transform_images(x, 16, o, 7, 0) - x.narrow(1, 0, 3)).abs().mean({1, 2, 3});
  EXPECT_NEAR(value((change > 0.01).to(at::kDouble).mean()), 0.4, 0.1);
}

TEST(EotDistribution, ShiftOfTheObject) {
  EotOptions o = no_transforms();
  const scene::ViewFrame frame = {{0, 0, 0}, 1, 3.2, 40};
  std::vector<scene::Camera> cameras(
      kDraws, scene::sample_views(scene::ViewDistribution::kDome, 1, 0, 1, 32, frame)[0].camera);
  const auto moved = [&] {
    const auto shifted = shift_object(cameras, 2, o, 7, 0);
    std::vector<double> by;
    for (const scene::Camera& c : shifted) {
      for (int k = 0; k < 3; ++k) by.push_back(c.position()[k] - cameras[0].position()[k]);
    }
    return at::tensor(by, at::kDouble).view({-1, 3});
  };
  EXPECT_EQ(value(moved().abs().max()), 0);
  o.object_shift = 0.1;
  for (int k = 0; k < 3; ++k) {
    expect_uniform(moved().select(1, k), -0.2, 0.2, "object shift, axis " + std::to_string(k));
  }
}

TEST(EotDistribution, LightHasAUniformDirectionAndItsShare) {
  // Three patches with the axes as normals; their factors give the drawn direction.
  EotOptions o = no_transforms();
  o.light = 0.5;
  Tensor normals = at::zeros({kDraws, 3, 1, 6});
  for (int k = 0; k < 3; ++k) {
    normals.select(1, k).select(2, 2 * k).fill_(2);
    normals.select(1, k).select(2, 2 * k + 1).fill_(-1);
  }
  const Tensor white = at::ones({kDraws, 4, 1, 6});
  const Tensor lit = light_pictures(white, normals, o, 7, 0);
  EXPECT_TRUE(at::equal(lit.select(1, 3), white.select(1, 3)));
  const Tensor factor = lit.select(1, 0).squeeze(1);
  // Opposite sides differ by 4 * share * cosine.
  const Tensor shares = (factor.select(1, 0) - factor.select(1, 1)).square() +
                        (factor.select(1, 2) - factor.select(1, 3)).square() +
                        (factor.select(1, 4) - factor.select(1, 5)).square();
  const Tensor share = shares.sqrt() / 4;
  expect_uniform(share, 0, 0.5, "share");
  for (int k = 0; k < 3; ++k) {
    const Tensor cosine = (factor.select(1, 2 * k) - factor.select(1, 2 * k + 1)) / (4 * share);
    expect_uniform(cosine, -1, 1, "direction, axis " + std::to_string(k));
  }
  // The mean over the six sides is unchanged.
  EXPECT_NEAR(value((factor.mean(1) - 1).abs().max()), 0, 1e-5);
  o.light = 0;
  EXPECT_TRUE(at::equal(light_pictures(white, normals, o, 7, 0), white));
}

TEST(EotDistribution, DiversityShrinksAndPadsWithBlack) {
  EotOptions o = no_transforms();
  o.diversity = 1;
  o.diversity_low = 0.5;
  const Tensor white = at::zeros({kDraws, 4, kSide, kSide});
  const Tensor x = transform_images(white, kSide, o, 7, 0).mean(1);
  const Tensor size = x.sum({1, 2}).sqrt() / kSide;
  expect_uniform(size, 0.5, 1, "size");
  // The whole picture stays in the frame, so its size bounds its position.
  const Tensor place = centroid(x, 2).abs() / kSide;
  EXPECT_LE(value((place - (1 - size) / 2).max()), 0.02);
  EXPECT_GE(value((place / ((1 - size) / 2 + 0.01)).max()), 0.9);
  o.diversity = 0.4;
  const Tensor share = (transform_images(white, kSide, o, 7, 0).mean({1, 2, 3}) < 0.999);
  EXPECT_NEAR(value(share.to(at::kDouble).mean()), 0.4, 0.1);
}

TEST(Eot, MixAddsAShareOfAPhotograph) {
  testing::TemporaryFolder folder;
  write_file_atomic(folder / "a.png", image::encode_png(at::full({6, 9, 3}, 51, at::kByte)));
  const scene::Backgrounds photographs(folder.path().string());
  EotOptions o = no_transforms();
  o.mix = 0.5;
  const Tensor x = squares(2, 0.6, 0.3, 0.95, kSide / 2);
  const Tensor out = transform_images(x, kSide, o, 1, 0, &photographs);
  const Tensor wanted = at::tensor({0.7F, 0.4F, 1.F}).view({1, 3, 1, 1});
  EXPECT_LT(value((out - wanted).abs().max()), 1e-3);
}

// ---- Operators ----------------------------------------------------------------------------

/// Reference of place_over in tensor operations.
Tensor reference_placement(const Tensor& renderings, const Tensor& maps, const Tensor& background,
                           int64_t size) {
  const Tensor grid = at::affine_grid_generator(maps, {renderings.size(0), 4, size, size}, false);
  const Tensor placed = at::grid_sampler(renderings, grid, 0, 0, false);
  return placed.narrow(1, 0, 3) + (1 - placed.narrow(1, 3, 1)) * background;
}

TEST(PlaceOver, EqualsTheTensorReferenceAndItsGradient) {
  const Tensor maps = testing::uniform({3, 2, 3}, -1.2, 1.2, 1);
  for (const int64_t side : {1, 10}) {
    const Tensor background = testing::uniform({3, 3, side, side}, 0, 1, 2);
    Tensor x = testing::uniform({3, 4, 9, 13}, 0, 1, 3).requires_grad_(true);
    Tensor y = x.detach().clone().requires_grad_(true);
    const Tensor ours = place_over(x, maps, background, 10);
    const Tensor reference = reference_placement(y, maps, background, 10);
    EXPECT_LT(value((ours - reference).abs().max()), 1e-12);
    ours.square().sum().backward();
    reference.square().sum().backward();
    EXPECT_LT(value((x.grad() - y.grad()).abs().max()), 1e-12);
    const auto loss = [&](const std::vector<Tensor>& in) {
      return place_over(in[0], maps, background, 10).square().sum();
    };
    EXPECT_LT(testing::gradient_error(loss, {x.detach()}), 1e-7);
  }
}

TEST(PlaceOver, UsesTheFirstChannelsOfAWiderPicture) {
  const Tensor maps = testing::uniform({2, 2, 3}, -1.2, 1.2, 1);
  const Tensor background = testing::uniform({2, 3, 1, 1}, 0, 1, 2);
  const Tensor wide = testing::uniform({2, 9, 70, 8}, 0, 1, 3);
  const Tensor part = wide.narrow(3, 4, 4).permute({0, 3, 1, 2});
  const Tensor ours = place_over(part, maps, background, 75);
  const Tensor wanted = reference_placement(part.contiguous(), maps, background, 75);
  EXPECT_LT(value((ours - wanted).abs().max()), 1e-12);
  EXPECT_TRUE(over_white(part).equal(over_white(part.contiguous())));
}

TEST(OverWhite, EqualsTheTensorReferenceAndItsGradient) {
  const auto reference = [](const Tensor& x) {
    return x.narrow(1, 0, 3) + (1 - x.narrow(1, 3, 1));
  };
  const Tensor x = testing::uniform({2, 4, 5, 13}, 0, 1, 3);
  EXPECT_LT(value((over_white(x) - reference(x)).abs().max()), 1e-15);
  const auto loss = [](const std::vector<Tensor>& in) { return over_white(in[0]).square().sum(); };
  EXPECT_LT(testing::gradient_error(loss, {x}), 1e-7);
}

TEST(GaussianBlur, EqualsTheTensorReferenceAndItsGradient) {
  for (const double sigma : {0.3, 1.0, 2.6}) {
    const auto radius = static_cast<int64_t>(std::ceil(2 * sigma));
    const Tensor line =
        (-at::arange(-radius, radius + 1, at::kDouble).square() / (2 * sigma * sigma)).exp();
    const Tensor kernel =
        (line.unsqueeze(1) * line / line.sum().square()).unsqueeze(0).unsqueeze(0);
    Tensor x = testing::uniform({2, 3, 7, 12}, 0, 1, 3).requires_grad_(true);
    Tensor y = x.detach().clone().requires_grad_(true);
    const Tensor ours = image::gaussian_blur(x, sigma);
    const Tensor padded =
        at::replication_pad2d(y.reshape({6, 1, 7, 12}), {radius, radius, radius, radius});
    const Tensor reference = at::conv2d(padded, kernel).view({2, 3, 7, 12});
    EXPECT_LT(value((ours - reference).abs().max()), 1e-12);
    ours.square().sum().backward();
    reference.square().sum().backward();
    EXPECT_LT(value((x.grad() - y.grad()).abs().max()), 1e-12);
    const auto loss = [&](const std::vector<Tensor>& in) {
      return image::gaussian_blur(in[0], sigma).square().sum();
    };
    EXPECT_LT(testing::gradient_error(loss, {x.detach()}), 1e-7);
  }
}

// ---- JPEG ---------------------------------------------------------------------------------

/// A picture [1,3,H,W] with smooth regions, edges and noise.
Tensor scene(int64_t height, int64_t width) {
  const Tensor y = at::linspace(0, 1, height).view({-1, 1}), x = at::linspace(0, 1, width);
  const Tensor disc = ((y - 0.5).square() + (x - 0.4).square() < 0.06).to(at::kFloat);
  const Tensor red = 0.2 + 0.6 * x + 0 * y, green = 0.5 + 0.3 * at::sin(9 * y + 4 * x);
  const Tensor blue = 0.8 - 0.5 * y + 0 * x;
  const Tensor plain = at::stack({red, green, blue}).unsqueeze(0);
  const Tensor grain = testing::uniform(plain.sizes(), -0.03, 0.03, 5).to(at::kFloat);
  return (plain * (1 - 0.6 * disc) + grain).clamp(0, 1);
}

double psnr_of(const Tensor& a, const Tensor& b) {
  return -10 * std::log10(value((a - b).square().mean()));
}

TEST(JpegStandIn, IsCloseToLibjpeg) {
  for (const auto& [height, width] : {std::pair{64, 64}, std::pair{50, 70}}) {
    const Tensor x = scene(height, width);
    const Tensor bytes = image::to_uint8(x[0].permute({1, 2, 0}));
    const Tensor shown = bytes.to(at::kFloat).permute({2, 0, 1}).unsqueeze(0) / 255;
    for (const int quality : {20, 50, 75, 95}) {
      const Tensor decoded = image::decode_image(image::encode_jpeg(bytes, quality), "x.jpg")
                                 .narrow(2, 0, 3)
                                 .to(at::kFloat) /
                             255;
      const Tensor real = decoded.permute({2, 0, 1}).unsqueeze(0);
      const Tensor ours = jpeg_stand_in(shown, {quality});
      const double loss = psnr_of(real, shown), error = psnr_of(real, ours);
      // The error is much smaller than that of JPEG itself.
      EXPECT_GT(error, loss + 4) << quality;
      EXPECT_GT(error, 30) << quality;
      EXPECT_NEAR(psnr_of(ours, shown), loss, 1.5) << quality;
    }
  }
}

TEST(JpegStandIn, EachPictureHasItsOwnQuality) {
  const Tensor x = scene(32, 32);
  const Tensor both = jpeg_stand_in(at::cat({x, x}), {10, 90});
  EXPECT_TRUE(at::allclose(both[0], jpeg_stand_in(x, {10})[0], 0, 1e-6));
  EXPECT_TRUE(at::allclose(both[1], jpeg_stand_in(x, {90})[0], 0, 1e-6));
}

TEST(JpegStandIn, GradientAgainstCentralDifferences) {
  const double error = testing::gradient_error(
      [](const std::vector<Tensor>& in) { return jpeg_stand_in(in[0], {60}).pow(2).sum(); },
      {testing::uniform({1, 3, 8, 8}, 0.3, 0.7, 6)});
  EXPECT_LT(error, 1e-5);
}

TEST(ResolutionAndJpeg, GradientReachesThePicture) {
  EotOptions o = no_transforms();
  o.resolution = 0.3;
  o.jpeg = 1;
  Tensor x = at::cat({scene(32, 32), at::ones({1, 1, 32, 32})}, 1).requires_grad_(true);
  const Tensor loss = transform_images(x, 32, o, 1, 0).square().sum();
  const Tensor grad = torch::autograd::grad({loss}, {x})[0];
  EXPECT_GT(value(grad.abs().max()), 0.01);
  EXPECT_TRUE(grad.isfinite().all().item<bool>());
}

}  // namespace
}  // namespace tt3d::attack
