#include "tt3d/attack.h"

#include <gtest/gtest.h>

#include <cmath>

#include "attack/toy_attack.h"
#include "support/count_notes.h"
#include "support/gradient_check.h"
#include "support/shapes.h"
#include "support/stop_after.h"
#include "support/temporary_folder.h"

namespace tt3d {
namespace {

using at::Tensor;
using testing::ball_input;

AttackOptions small_options() {
  AttackOptions o;
  o.steps = 40;
  o.views_per_step = 2;
  o.image_size = 32;
  o.beta = 0;
  o.eot.plain_background = 0;
  o.checkpoint_every = 6;
  return o;
}

TEST(Attack, ReachesEveryTargetOfAToyClassifier) {
  Progress quiet;
  for (const std::string& method : attack_method_names()) {
    for (const int64_t target : {0, 2}) {
      testing::TemporaryFolder folder;
      AttackOptions o = small_options();
      o.method = method;
      const AttackResult r = run_attack(ball_input(target), o, 1, folder / "c", quiet);
      double success = 0;
      for (size_t i = r.curves.size() - 10; i < r.curves.size(); ++i)
        success += r.curves[i].success;
      EXPECT_GE(success, 9.0) << method << " " << target;
    }
  }
}

TEST(Attack, OnlyTheMethodsParametersMove) {
  Progress quiet;
  const AttackInput input = ball_input(1);
  for (const std::string& name : attack_method_names()) {
    testing::TemporaryFolder folder;
    AttackOptions o = small_options();
    o.method = name;
    o.steps = 5;
    const AttackResult r = run_attack(input, o, 1, folder / "c", quiet);
    const AttackMethod method = attack_method(name);
    EXPECT_EQ(at::equal(r.mesh.vertices, input.mesh.vertices), !method.vertices) << name;
    EXPECT_EQ(at::equal(r.appearance.grid, input.appearance.grid), !method.grid) << name;
    EXPECT_EQ(at::equal(r.appearance.color_mlp[0], input.appearance.color_mlp[0]), !method.mlp);
    EXPECT_TRUE(at::equal(r.mesh.faces, input.mesh.faces));
  }
}

TEST(Attack, StrongerBetaStaysNearerToTheCleanObject) {
  Progress quiet;
  double before = 1e9;
  for (const double beta : {0.0, 1e3, 1e5}) {
    testing::TemporaryFolder folder;
    AttackOptions o = small_options();
    o.beta = beta;
    const AttackResult r = run_attack(ball_input(0), o, 1, folder / "c", quiet);
    EXPECT_LT(r.curves.back().rgb, before);
    before = r.curves.back().rgb;
  }
}

TEST(Attack, AFloorOnSimilarityHoldsTheColoursBack) {
  Progress quiet;
  std::vector<double> distance;
  for (const double floor : {0.0, 1.0}) {
    testing::TemporaryFolder folder;
    AttackOptions o = small_options();
    o.beta = 1e3;
    o.rgb_weight = 0;
    o.ssim_floor = floor;
    distance.push_back(run_attack(ball_input(0), o, 1, folder / "c", quiet).curves.back().rgb);
  }
  EXPECT_LT(distance[1], 0.5 * distance[0]);
}

TEST(Attack, ResumedAfterAnyStopGivesTheSameBytes) {
  Progress quiet;
  testing::TemporaryFolder folder;
  const AttackInput input = ball_input(0);
  const AttackOptions o = small_options();
  const AttackResult whole = run_attack(input, o, 1, folder / "whole", quiet);
  Random random(7, "stops");
  for (int stops = 0; stops < 4; ++stops) {
    testing::StopAfter stop(static_cast<int>(1 + random.index(15)));
    try {
      (void)run_attack(input, o, 1, folder / "stopped", stop);
    } catch (const Interrupted&) {
    }
  }
  const AttackResult again = run_attack(input, o, 1, folder / "stopped", quiet);
  save_attack(whole, folder / "a.safetensors");
  save_attack(again, folder / "b.safetensors");
  EXPECT_EQ(read_file(folder / "a.safetensors"), read_file(folder / "b.safetensors"));
}

/// A classifier whose answers are not numbers from call `first` to call `last`.
class FailingClassifier : public testing::ColorClassifier {
 public:
  FailingClassifier(int first, int last) : first_(first), last_(last) {}
  [[nodiscard]] Tensor logits(const Tensor& images) const override {
    const int call = ++calls_;
    const bool fails = call >= first_ && call <= last_;
    return ColorClassifier::logits(images) * (fails ? std::nan("") : 1.0);
  }

 private:
  int first_, last_;
  mutable int calls_ = 0;
};

TEST(Attack, GoesOnAtHalfTheRateAfterALossThatIsNotANumber) {
  testing::TemporaryFolder folder;
  AttackInput input = ball_input(0);
  input.surrogates = {std::make_shared<FailingClassifier>(14, 15)};
  testing::CountNotes notes;
  const AttackResult r = run_attack(input, small_options(), 1, folder / "c", notes);
  EXPECT_EQ(notes.count, 2);
  // Rolled back to the checkpoint at step 12, and no step is missing or there twice.
  ASSERT_EQ(r.curves.size(), 40U);
  for (size_t i = 0; i < r.curves.size(); ++i) {
    EXPECT_EQ(r.curves[i].step, static_cast<int64_t>(i));
    EXPECT_TRUE(std::isfinite(r.curves[i].loss));
  }
}

TEST(Attack, StopsAfterThreeRollBacks) {
  testing::TemporaryFolder folder;
  AttackInput input = ball_input(0);
  input.surrogates = {std::make_shared<FailingClassifier>(14, 1000)};
  testing::CountNotes notes;
  EXPECT_THROW((void)run_attack(input, small_options(), 1, folder / "c", notes), NumericError);
  EXPECT_EQ(notes.count, 3);
}

TEST(Attack, SaveAndLoad) {
  Progress quiet;
  testing::TemporaryFolder folder;
  AttackOptions o = small_options();
  o.steps = 3;
  const AttackResult r = run_attack(ball_input(0), o, 1, folder / "c", quiet);
  save_attack(r, folder / "r.safetensors");
  const AttackResult back = load_attack(folder / "r.safetensors");
  EXPECT_TRUE(at::equal(r.mesh.vertices, back.mesh.vertices));
  EXPECT_TRUE(at::equal(r.appearance.grid, back.appearance.grid));
  EXPECT_EQ(curves_csv(r.curves), curves_csv(back.curves));
}

TEST(Attack, UnknownNamesAreInputErrors) {
  EXPECT_THROW((void)attack_method("dula"), InputError);
  EXPECT_THROW((void)objective_loss("logits", at::zeros({1, 3}), 0), InputError);
}

TEST(Objective, ValuesByHand) {
  const Tensor logits = at::tensor({1.F, 2.F, 4.F}).view({1, 3});
  EXPECT_NEAR(objective_loss("logit", logits, 1).item<double>(), -2, 1e-6);
  EXPECT_NEAR(objective_loss("cross-entropy", logits, 2).item<double>(), 0.16984, 1e-4);
  EXPECT_NEAR(objective_loss("margin", logits, 0).item<double>(), 3.12693, 1e-4);
}

TEST(Eot, PaddingIsBackgroundAndNeverBlack) {
  // A fully transparent rendering is background alone, whatever the placement.
  EotOptions o;
  o.brightness = o.contrast = o.saturation = o.noise = o.plain_background = 0;
  const Tensor out = transform_images(at::zeros({4, 4, 20, 20}), 24, o, 1, 0);
  EXPECT_NEAR(out.min().item<double>(), 1, 1e-6);
}

TEST(Eot, PhotographsStandBehindTheObject) {
  testing::TemporaryFolder folder;
  write_file_atomic(folder / "a.png", encode_png(at::full({6, 9, 3}, 51, at::kByte)));
  const Backgrounds photographs(folder.path().string());
  EotOptions o;
  o.brightness = o.contrast = o.saturation = o.noise = o.plain_background = 0;
  o.photograph_background = 1;
  const Tensor out = transform_images(at::zeros({2, 4, 20, 20}), 24, o, 1, 0, &photographs);
  EXPECT_LT((out - 0.2).abs().max().item<double>(), 1e-4);
}

TEST(Eot, IdentityWhenEveryRangeIsZero) {
  EotOptions o;
  o.scale_low = o.scale_high = 1;
  o.shift = o.rotation_deg = o.brightness = o.contrast = o.saturation = o.blur = o.noise = 0;
  o.plain_background = 0;
  Tensor x = testing::uniform({2, 4, 16, 16}, 0, 1, 3).to(at::kFloat);
  x.select(1, 3).fill_(1);
  EXPECT_LT((transform_images(x, 16, o, 1, 0) - x.narrow(1, 0, 3)).abs().max().item<double>(),
            1e-5);
}

TEST(Eot, EachTransformActsAndDependsOnTheStep) {
  EotOptions none;
  none.scale_low = none.scale_high = 1;
  none.shift = none.rotation_deg = none.brightness = none.contrast = none.saturation = 0;
  none.blur = none.noise = none.plain_background = 0;
  Tensor x = testing::uniform({1, 4, 16, 16}, 0, 0.8, 3).to(at::kFloat);
  const Tensor base = transform_images(x, 16, none, 1, 0);
  std::vector<EotOptions> each(8, none);
  each[0].scale_low = 0.5;
  each[1].shift = 0.3;
  each[2].rotation_deg = 45;
  each[3].brightness = each[4].contrast = each[5].saturation = 0.5;
  each[6].blur = 3;
  each[7].noise = 0.2;
  for (size_t i = 0; i < each.size(); ++i) {
    const Tensor a = transform_images(x, 16, each[i], 1, 1);
    EXPECT_FALSE(at::equal(a, base)) << i;
    EXPECT_FALSE(at::equal(a, transform_images(x, 16, each[i], 1, 2))) << i;
    EXPECT_TRUE(at::equal(a, transform_images(x, 16, each[i], 1, 1))) << i;
  }
}

}  // namespace
}  // namespace tt3d
