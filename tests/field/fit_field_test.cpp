#include <ATen/core/grad_mode.h>
#include <gtest/gtest.h>

#include <cmath>

#include "support/count_notes.h"
#include "support/stop_after.h"
#include "support/synthetic_capture.h"
#include "support/temporary_folder.h"
#include "tt3d/capture.h"
#include "tt3d/field.h"
#include "tt3d/image.h"
#include "tt3d/scene.h"

namespace tt3d::field {
namespace {

using at::Tensor;

FieldOptions small_options() {
  FieldOptions o;
  o.shape.geometry = {6, 8, 64, 12, 1};
  o.shape.appearance = {6, 8, 64, 12, 2};
  o.shape.occupancy = 32;
  o.steps = 60;
  o.samples_per_step = 8192;
  o.ray_steps = 96;
  o.checkpoint_every = 7;
  return o;
}

bool same_bytes(const RadianceField& a, const RadianceField& b) {
  const auto x = a.parameters(), y = b.parameters();
  for (size_t i = 0; i < x.size(); ++i) {
    if (!at::equal(x[i], y[i])) return false;
  }
  return at::equal(a.occupied, b.occupied);
}

TEST(Background, StraightAlphaIsPremultipliedOnce) {
  // Half-transparent red over white: (1 + 0) / 2 in green and blue, 1 in red.
  capture::View view;
  view.rgba = at::tensor({255, 0, 0, 128}, at::kByte).view({1, 1, 4});
  const Tensor rgba = image::premultiplied(view.rgba);
  EXPECT_NEAR(rgba[0][0][0].item<double>(), 128.0 / 255, 1e-6);
  const Tensor over = image::over_background(rgba, at::ones({3}));
  EXPECT_NEAR(over[0][0][0].item<double>(), 1, 1e-6);
  EXPECT_NEAR(over[0][0][1].item<double>(), 127.0 / 255, 1e-6);
}

TEST(Background, TrainAndTestImagesFollowTheSamePolicy) {
  const capture::Capture capture = testing::ball_capture(8, 24);
  for (const auto* views : {&capture.train, &capture.test}) {
    for (const capture::View& view : *views) {
      const Tensor rgba = image::premultiplied(view.rgba);
      // Colour never exceeds alpha, and empty pixels are empty in every channel.
      EXPECT_LE((rgba.narrow(2, 0, 3) - rgba.narrow(2, 3, 1)).max().item<float>(), 1e-6F);
      const Tensor white = image::over_background(rgba, at::ones({3}));
      EXPECT_NEAR(white[0][0].min().item<float>(), 1, 1e-6);
    }
  }
}

TEST(FitField, LearnsABallAndItsColours) {
  const capture::Capture capture = testing::ball_capture(24, 40);
  FieldOptions o = small_options();
  o.steps = 250;
  Progress quiet;
  testing::TemporaryFolder folder;
  const RadianceField f = fit_field(capture, o, 1, folder / "c.safetensors", quiet);
  const double psnr = capture::mean_psnr(
      capture.test, [&](const scene::Camera& c) { return render_field(f, c, ray_step(o)); }, quiet);
  EXPECT_GT(psnr, 24);
  at::NoGradGuard guard;
  EXPECT_LT(f.density(at::tensor({0.9F, 0.9F, 0.9F}).view({1, 3})).item<float>(), 200);
}

TEST(FitField, SameSeedSameBytesOtherSeedOtherBytes) {
  const capture::Capture capture = testing::ball_capture(8, 24);
  Progress quiet;
  testing::TemporaryFolder folder;
  FieldOptions o = small_options();
  o.steps = 20;
  o.checkpoint_every = 1000;
  const RadianceField a = fit_field(capture, o, 1, folder / "a", quiet);
  EXPECT_TRUE(same_bytes(a, fit_field(capture, o, 1, folder / "a", quiet)));
  EXPECT_FALSE(same_bytes(a, fit_field(capture, o, 2, folder / "a", quiet)));
}

TEST(FitField, ResumedAfterAnyStopGivesTheSameBytes) {
  const capture::Capture capture = testing::ball_capture(8, 24);
  Progress quiet;
  testing::TemporaryFolder folder;
  const FieldOptions o = small_options();
  const RadianceField whole = fit_field(capture, o, 1, folder / "whole", quiet);
  Random random(5, "stops");
  const auto checkpoint = folder / "stopped";
  for (int stops = 0; stops < 4; ++stops) {
    // 56 steps at most: every stop comes before the end.
    testing::StopAfter stop(static_cast<int>(1 + random.index(14)));
    EXPECT_THROW((void)fit_field(capture, o, 1, checkpoint, stop), Interrupted) << stops;
  }
  EXPECT_TRUE(same_bytes(whole, fit_field(capture, o, 1, checkpoint, quiet)));
}

TEST(FitField, SaveAndLoad) {
  testing::TemporaryFolder folder;
  const RadianceField f = RadianceField::create(small_options().shape, 3);
  f.save(folder / "f.safetensors");
  EXPECT_TRUE(same_bytes(f, RadianceField::load(folder / "f.safetensors")));
}

TEST(FitField, CaptureWithoutMasksIsRefused) {
  capture::Capture capture = testing::ball_capture(4, 16);
  capture.has_masks = false;
  Progress quiet;
  EXPECT_THROW((void)fit_field(capture, small_options(), 1, "/nonexistent/c", quiet), InputError);
}

TEST(FitField, DivergenceRollsBackThreeTimesAndThenStops) {
  const capture::Capture capture = testing::ball_capture(4, 16);
  FieldOptions o = small_options();
  o.rate = 1e30;  // weights overflow at once
  o.warmup = 0;
  testing::CountNotes notes;
  testing::TemporaryFolder folder;
  EXPECT_THROW((void)fit_field(capture, o, 1, folder / "c", notes), NumericError);
  EXPECT_EQ(notes.count, 3);
}

}  // namespace
}  // namespace tt3d::field
