#include "tt3d/attack.h"
#include "tt3d/appearance.h"
#include "tt3d/raster.h"

#include <ATen/core/grad_mode.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "attack/run_attack.h"
#include "attack/starting_appearance.h"
#include "attack/toy_attack.h"
#include "support/count_notes.h"
#include "support/error_of.h"
#include "support/gradient_check.h"
#include "support/shapes.h"
#include "support/stop_after.h"
#include "support/temporary_folder.h"
#include "tt3d/tensor_file.h"

namespace tt3d::attack {
namespace {

using at::Tensor;
using testing::ball_input;
using testing::toy_options;

/// Mean success over the last ten steps.
double late_success(const AttackResult& r) {
  double success = 0;
  for (size_t i = r.curves.size() - 10; i < r.curves.size(); ++i) success += r.curves[i].success;
  return success / 10;
}

TEST(Attack, EachPresetReachesEveryTargetOfAToyClassifier) {
  Progress quiet;
  for (const AttackPreset& preset : attack_presets()) {
    const AttackOptions o = toy_options(preset);
    if (!testing::frees_colors(o))
      continue;  // an attack on the shape or on a patch alone is too
                 // weak
    for (const int64_t target : {0, 2}) {
      testing::TemporaryFolder folder;
      const AttackResult r = run_attack(ball_input(target), o, 1, folder / "c", quiet);
      EXPECT_GE(late_success(r), 0.8) << preset.name << " " << target;
    }
  }
}

TEST(Attack, EachPresetChangesItsOwnParametersOnly) {
  Progress quiet;
  const AttackInput input = ball_input(1);
  for (const AttackPreset& preset : attack_presets()) {
    testing::TemporaryFolder folder;
    AttackOptions o = toy_options(preset);
    o.schedule.steps = 5;
    const AttackResult r = run_attack(input, o, 1, folder / "c", quiet);
    EXPECT_EQ(at::equal(r.object.mesh.vertices, input.object.mesh.vertices),
              !o.optimizes(object::Part::kVertices))
        << preset.name;
    EXPECT_TRUE(at::equal(r.object.mesh.faces, input.object.mesh.faces));
    const auto start = starting_appearance(input, o);
    const auto clean = start->groups(), moved = r.object.appearance->groups();
    ASSERT_EQ(moved.size(), clean.size());
    for (size_t g = 0; g < moved.size(); ++g) {
      for (size_t i = 0; i < moved[g].tensors.size(); ++i) {
        EXPECT_EQ(at::equal(moved[g].tensors[i], clean[g].tensors[i]), !o.optimizes(moved[g].part))
            << preset.name << " " << name_of(moved[g].part);
      }
    }
  }
}

TEST(Attack, PartsThatCannotBeCombinedAreInputErrors) {
  Progress quiet;
  testing::TemporaryFolder folder;
  using object::Part;
  for (const std::vector<Part>& parts :
       {std::vector{Part::kGrid, Part::kVertexColors}, std::vector<Part>{},
        std::vector{Part::kTexture, Part::kTile}}) {
    AttackOptions o = toy_options();
    o.optimize = parts;
    EXPECT_THROW((void)run_attack(ball_input(0), o, 1, folder / "c", quiet), InputError);
  }
}

TEST(Attack, ATextureNeedsAUvMap) {
  AttackInput input = ball_input(0);
  AttackOptions o = toy_options(attack_preset("triplanar"));
  EXPECT_FALSE(needs_uv_map(o));
  input.object.map.reset();
  for (const char* preset : {"texture", "repeated"}) {
    o = toy_options(attack_preset(preset));
    EXPECT_TRUE(needs_uv_map(o)) << preset;
    EXPECT_THROW((void)starting_appearance(input, o), InputError) << preset;
  }
}

TEST(Attack, AnUntargetedAttackLeavesTheTrueClass) {
  Progress quiet;
  testing::TemporaryFolder folder;
  const AttackInput input = ball_input(0);
  AttackOptions o = toy_options();
  const AttackResult red = run_attack(input, o, 1, folder / "red", quiet);
  ASSERT_GE(late_success(red), 0.9);
  // Start from the red ball and leave class red.
  AttackInput from_red = input;
  from_red.object.mesh = red.object.mesh;
  from_red.object.appearance = red.object.appearance;
  o.objective.goal = Goal::kUntargeted;
  o.schedule.steps = 120;
  const AttackResult r = run_attack(from_red, o, 1, folder / "c", quiet);
  EXPECT_LE(r.curves.front().success, 0.5);
  EXPECT_GE(late_success(r), 0.9);
}

TEST(Attack, ALargerBetaStaysCloserToTheCleanObject) {
  Progress quiet;
  double before = 1e9;
  for (const double beta : {0.0, 1e3, 1e5}) {
    testing::TemporaryFolder folder;
    AttackOptions o = toy_options();
    o.naturalness.beta = beta;
    const AttackResult r = run_attack(ball_input(0), o, 1, folder / "c", quiet);
    EXPECT_LT(r.curves.back().rgb, before);
    before = r.curves.back().rgb;
  }
}

TEST(Attack, AFloorOnSimilarityLimitsTheChangeOfColours) {
  Progress quiet;
  std::vector<double> distance;
  for (const double floor : {0.0, 1.0}) {
    testing::TemporaryFolder folder;
    AttackOptions o = toy_options();
    o.naturalness.beta = 1e3;
    o.naturalness.rgb_weight = 0;
    o.naturalness.ssim_floor = floor;
    distance.push_back(run_attack(ball_input(0), o, 1, folder / "c", quiet).curves.back().rgb);
  }
  EXPECT_LT(distance[1], 0.5 * distance[0]);
}

TEST(Attack, MomentumAccumulatesScaledGradients) {
  // Two steps with known gradients; Adam then uses the velocity.
  AttackOptions o = toy_options();
  o.optimize = {object::Part::kVertices};
  o.schedule.momentum = 0.5;
  const AttackInput input = ball_input(0);
  Attack attack(input, o, 1);
  attack.restart();
  Tensor first = at::zeros_like(input.object.mesh.vertices), second = at::zeros_like(first);
  const auto count = static_cast<double>(first.numel());
  first[0][0] = 3;  // scaled to a mean magnitude of 1, this entry is `count`
  second[0][0] = -1;
  second[1][0] = 1;  // scaled, both entries have magnitude count / 2
  attack.gradients() = {first};
  attack.apply(0, 1);
  EXPECT_NEAR(attack.velocity()[0][0][0].item<double>(), count, 1e-3 * count);
  attack.gradients() = {second};
  attack.apply(0, 1);
  EXPECT_NEAR(attack.velocity()[0][0][0].item<double>(), 0, 1e-3 * count);
  EXPECT_NEAR(attack.velocity()[0][1][0].item<double>(), count / 2, 1e-3 * count);
}

/// Records the pictures and the feature mix of the last call.
class MixWitness : public testing::ColorClassifier {
 public:
  [[nodiscard]] Tensor mixed_logits(const Tensor& images,
                                    const model::FeatureMix& mix) const override {
    seen = images.detach();
    competitors = mix;
    return logits(images);
  }
  mutable Tensor seen;
  mutable model::FeatureMix competitors;
};

TEST(Attack, FeatureMixGetsTheCleanObjectInTheSameViews) {
  Progress quiet;
  AttackInput input = ball_input(0);
  const auto witness = std::make_shared<MixWitness>();
  input.surrogates = {witness};
  AttackOptions o = toy_options();
  o.eot = testing::no_transforms();
  o.objective.feature_mix = 0.3;
  o.objective.feature_mix_share = 0.6;
  o.schedule.steps = 1;
  testing::TemporaryFolder folder;
  (void)run_attack(input, o, 1, folder / "one", quiet);
  EXPECT_EQ(witness->competitors.probability, 0.3);
  EXPECT_EQ(witness->competitors.share, 0.6);
  EXPECT_FALSE(witness->competitors.images.requires_grad());
  EXPECT_TRUE(at::allclose(witness->competitors.images, witness->seen));  // nothing has changed yet
  o.schedule.steps = 20;
  (void)run_attack(input, o, 1, folder / "more", quiet);
  const Tensor own = witness->seen.mean({0, 2, 3}),
               other = witness->competitors.images.mean({0, 2, 3});
  EXPECT_GT(own[0].item<float>(), other[0].item<float>() + 0.01F);  // the attacked ball is redder
                                                                    // than the clean ball
}

TEST(Attack, SchedulesDecreaseFromOneToTheFinalRate) {
  AttackOptions o;
  o.schedule.final_rate = 0.2;
  for (const Schedule schedule : {Schedule::kExponential, Schedule::kCosine}) {
    o.schedule.schedule = schedule;
    EXPECT_NEAR(rate_share(o.schedule, 0), 1, 1e-12) << name_of(schedule);
    EXPECT_NEAR(rate_share(o.schedule, 1), 0.2, 1e-12) << name_of(schedule);
  }
  o.schedule.schedule = Schedule::kCosine;
  EXPECT_NEAR(rate_share(o.schedule, 0.5), 0.6, 1e-12);
  EXPECT_NEAR(rate_share(o.schedule, 1.0 / 3), 0.8, 1e-12);
}

TEST(Attack, ResumedAfterAnyStopGivesTheSameBytes) {
  Progress quiet;
  const AttackInput input = ball_input(0);
  for (const char* preset : {"dual", "mesh", "strong"}) {
    testing::TemporaryFolder folder;
    AttackOptions o = toy_options(attack_preset(preset));
    if (preset == std::string("mesh")) o.schedule.epoch = 4, o.schedule.held_out_views = 3;
    if (preset == std::string("strong")) o.objective.feature_mix = 0.5;
    const AttackResult whole = run_attack(input, o, 1, folder / "whole", quiet);
    Random random(7, "stops");
    for (int stops = 0; stops < 4; ++stops) {
      // 36 steps at most: every stop comes before the end.
      testing::StopAfter stop(static_cast<int>(1 + random.index(9)));
      EXPECT_THROW((void)run_attack(input, o, 1, folder / "stopped", stop), Interrupted) << stops;
    }
    const AttackResult again = run_attack(input, o, 1, folder / "stopped", quiet);
    save_attack(whole, folder / "a.safetensors");
    save_attack(again, folder / "b.safetensors");
    EXPECT_EQ(read_file(folder / "a.safetensors"), read_file(folder / "b.safetensors")) << preset;
    EXPECT_EQ(record::epochs_csv(whole.epochs), record::epochs_csv(again.epochs));
  }
}

// ---- Several objects ----------------------------------------------------------------------

/// The toy ball stretched along an axis.
AttackInput stretched_ball(int64_t target, int64_t axis, double by) {
  AttackInput input = ball_input(target);
  Tensor scale = at::ones({3});
  scale[axis] = by;
  input.object.mesh.vertices = input.object.mesh.vertices * scale;
  return input;
}

/// Success of an appearance on an object, measured by an attack with learning rates of almost 0.
double success_of(const std::shared_ptr<const object::Appearance>& appearance, AttackInput input) {
  Progress quiet;
  testing::TemporaryFolder folder;
  input.object.appearance = appearance;
  input.also.clear();
  AttackOptions o = toy_options();
  o.optimize = {object::Part::kVertices};
  o.schedule.vertex_rate = 1e-12;
  o.schedule.steps = 10;
  return late_success(run_attack(input, o, 3, folder / "c", quiet));
}

TEST(Universal, OneTileImprovesEveryObject) {
  Progress quiet;
  testing::TemporaryFolder folder;
  AttackInput input = ball_input(0);
  input.also = {stretched_ball(0, 0, 0.5), stretched_ball(0, 2, 1.3)};
  AttackOptions o = toy_options(attack_preset("triplanar"));
  const AttackResult r = run_attack(input, o, 1, folder / "c", quiet);
  EXPECT_GE(late_success(r), 0.9);
  for (const AttackInput& other : input.also) {
    const AttackResult applied = apply_appearance(r, other);
    EXPECT_TRUE(at::equal(applied.object.mesh.vertices, other.object.mesh.vertices));
    EXPECT_TRUE(at::equal(applied.object.appearance->parameters()[0],
                          r.object.appearance->parameters()[0]));
    const double before = success_of(starting_appearance(other, o), other);
    EXPECT_GE(success_of(applied.object.appearance, other), std::max(0.9, before + 0.1));
  }
}

TEST(Universal, GradientsAreMeansOverTheObjects) {
  AttackInput one = ball_input(0), two = stretched_ball(0, 0, 0.5), both = one;
  both.also = {two};
  AttackOptions o = toy_options(attack_preset("triplanar"));
  std::vector<Tensor> grads[3];
  double losses[3];
  AttackInput* inputs[3] = {&one, &two, &both};
  // Use one tile for all three: their own starting tiles have the mean colours of their objects.
  const Tensor tile = at::full({o.tile.tile_size, o.tile.tile_size, 3}, 0.4);
  for (int i = 0; i < 3; ++i) {
    Attack attack(*inputs[i], o, 1);
    attack.restart();
    {
      at::NoGradGuard guard;
      attack.free_parameters()[0].tensor.copy_(tile);
    }
    const optimize::StepLoss loss = attack.compute(0);
    grads[i] = attack.gradients();
    losses[i] = loss.loss;
  }
  EXPECT_TRUE(at::allclose(grads[2][0], (grads[0][0] + grads[1][0]) / 2, 1e-5, 1e-7));
  EXPECT_NEAR(losses[2], (losses[0] + losses[1]) / 2, 1e-9);
}

TEST(Universal, AppearancesOfOneObjectAndPartVerticesAreInputErrors) {
  Progress quiet;
  testing::TemporaryFolder folder;
  AttackInput input = ball_input(0);
  input.also = {stretched_ball(0, 0, 0.5)};
  for (const char* preset : {"dual", "dual-texture-only", "texture"}) {
    const AttackOptions o = toy_options(attack_preset(preset));
    EXPECT_THROW((void)run_attack(input, o, 1, folder / "c", quiet), InputError) << preset;
  }
}

// ---- Epochs -------------------------------------------------------------------------------

/// The toy attack with epochs.
AttackOptions epochs_of_five() {
  AttackOptions o = toy_options();
  o.schedule.epoch = 5;
  o.schedule.held_out_views = 3;
  return o;
}

TEST(Epochs, AreLoggedAndTheBestStateIsKept) {
  Progress quiet;
  testing::TemporaryFolder folder;
  const AttackInput input = ball_input(0);
  AttackOptions o = epochs_of_five();
  const AttackResult r = run_attack(input, o, 1, folder / "c", quiet);
  ASSERT_EQ(r.epochs.size(), 8U);
  for (size_t e = 0; e < 8; ++e) {
    EXPECT_EQ(r.epochs[e].step, static_cast<int64_t>(5 * (e + 1)));
    double success = 0;
    for (size_t i = 5 * e; i < 5 * e + 5; ++i) success += r.curves[i].success / 5;
    EXPECT_NEAR(r.epochs[e].success, success, 1e-12);
  }
  EXPECT_EQ(r.epochs.back().held_out, 1);
  // Scoring has its own random stream, so the steps equal those of an attack without epochs.
  o.schedule.epoch = 0;
  const AttackResult plain = run_attack(input, o, 1, folder / "d", quiet);
  EXPECT_EQ(record::curves_csv(plain.curves), record::curves_csv(r.curves));
  EXPECT_TRUE(plain.epochs.empty());
  EXPECT_EQ(record::epochs_csv({{5, -1.5, 0.25, 0.5}}),
            "step,objective,success,held_out\n5,-1.5,0.2500,0.5000\n");
}

TEST(Epochs, TheAttackStopsAfterEpochsWithoutProgress) {
  // Nothing changes at this rate, so no epoch is better than the first.
  Progress quiet;
  testing::TemporaryFolder folder;
  AttackOptions o = epochs_of_five();
  o.schedule.appearance_rate = o.schedule.vertex_rate = 1e-12;
  o.schedule.patience = 3;
  const AttackResult r = run_attack(ball_input(0), o, 1, folder / "c", quiet);
  EXPECT_EQ(r.epochs.size(), 4U);
  EXPECT_EQ(r.curves.size(), 20U);
}

/// A classifier whose logits change sign after a number of batches.
class TurningClassifier : public testing::ColorClassifier {
 public:
  explicit TurningClassifier(int turn) : turn_(turn) {}
  [[nodiscard]] Tensor logits(const Tensor& images) const override {
    return ColorClassifier::logits(images) * (++calls_ > turn_ ? -1.0 : 1.0);
  }

 private:
  int turn_;
  mutable int calls_ = 0;
};

TEST(Epochs, TheBestStateIsReturnedIfTheLastIsWorse) {
  Progress quiet;
  testing::TemporaryFolder folder;
  AttackOptions o = epochs_of_five();
  o.schedule.epoch = 10;
  o.schedule.steps = 30;
  o.schedule.final_rate = 1;  // the rates do not depend on the number of steps
  // An epoch has ten steps and two batches of held-out views. After 24 calls the logits change
  // sign, so the third epoch scores worse than the second.
  AttackInput input = ball_input(0);
  input.surrogates = {std::make_shared<TurningClassifier>(24)};
  const AttackResult r = run_attack(input, o, 1, folder / "c", quiet);
  ASSERT_EQ(r.epochs.size(), 3U);
  ASSERT_LT(r.epochs[2].held_out, r.epochs[1].held_out);
  // The result is the state after 20 steps.
  o.schedule.steps = 20;
  o.schedule.epoch = 0;
  const AttackResult at_best = run_attack(ball_input(0), o, 1, folder / "d", quiet);
  EXPECT_TRUE(at::equal(r.object.mesh.vertices, at_best.object.mesh.vertices));
  EXPECT_TRUE(
      at::equal(r.object.appearance->parameters()[0], at_best.object.appearance->parameters()[0]));
}

/// A classifier whose weights change when it is used.
class ChangingClassifier : public testing::ColorClassifier {
 public:
  [[nodiscard]] Tensor logits(const Tensor& images) const override {
    ++calls_;
    return ColorClassifier::logits(images);
  }
  [[nodiscard]] std::string weights_hash() const override { return std::to_string(calls_); }

 private:
  mutable int calls_ = 0;
};

TEST(Attack, StopsIfTheWeightsOfASurrogateChanged) {
  testing::TemporaryFolder folder;
  AttackInput input = ball_input(0);
  input.surrogates = {std::make_shared<ChangingClassifier>()};
  Progress quiet;
  const std::string error = testing::error_of<Error>(
      [&] { (void)run_attack(input, toy_options(), 1, folder / "c", quiet); });
  EXPECT_NE(error.find("its weights changed while it was used"), std::string::npos) << error;
}

/// A classifier that returns NaN from call `first` to call `last`.
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

TEST(Attack, ContinuesAtHalfTheRateAfterALossThatIsNaN) {
  testing::TemporaryFolder folder;
  AttackInput input = ball_input(0);
  input.surrogates = {std::make_shared<FailingClassifier>(14, 15)};
  testing::CountNotes notes;
  const AttackResult r = run_attack(input, toy_options(), 1, folder / "c", notes);
  EXPECT_EQ(notes.count, 2);
  // The attack rolled back to the checkpoint at step 12; the log has each step exactly once.
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
  EXPECT_THROW((void)run_attack(input, toy_options(), 1, folder / "c", notes), NumericError);
  EXPECT_EQ(notes.count, 3);
}

/// A classifier on a device with memory for two pictures.
class SmallClassifier : public testing::ColorClassifier {
 public:
  [[nodiscard]] Tensor logits(const Tensor& images) const override {
    if (images.size(0) > 2) C10_THROW_ERROR(OutOfMemoryError, "no more than two pictures");
    return ColorClassifier::logits(images);
  }
};

TEST(Attack, OutOfMemoryHalvesTheViewsAndContinues) {
  testing::TemporaryFolder folder;
  AttackInput input = ball_input(0);
  input.surrogates = {std::make_shared<SmallClassifier>()};
  AttackOptions o = toy_options();
  o.schedule.views_per_step = 8;
  testing::CountNotes notes;
  const AttackResult r = run_attack(input, o, 1, folder / "c", notes);
  EXPECT_EQ(notes.count, 2);  // to four views, then to two
  EXPECT_EQ(r.curves.size(), 40U);
  EXPECT_GE(late_success(r), 0.9);
}

TEST(Attack, OutOfMemoryWithOneViewIsAnErrorWithAdvice) {
  testing::TemporaryFolder folder;
  AttackInput input = ball_input(0);
  struct NoClassifier : testing::ColorClassifier {
    [[nodiscard]] Tensor logits(const Tensor&) const override {
      C10_THROW_ERROR(OutOfMemoryError, "no picture");
    }
  };
  input.surrogates = {std::make_shared<NoClassifier>()};
  Progress quiet;
  EXPECT_THROW((void)run_attack(input, toy_options(), 1, folder / "c", quiet), ResourceError);
}

TEST(Attack, EveryPresetSurvivesSavingAndLoading) {
  Progress quiet;
  for (const AttackPreset& preset : attack_presets()) {
    testing::TemporaryFolder folder;
    AttackOptions o = toy_options(preset);
    o.schedule.steps = 2;
    const AttackResult r = run_attack(ball_input(0), o, 1, folder / "c", quiet);
    save_attack(r, folder / "r.safetensors");
    const object::Object back = object::load_object(folder / "r.safetensors");
    EXPECT_TRUE(at::equal(r.object.mesh.vertices, back.mesh.vertices));
    const auto before = r.object.appearance->parameters(), after = back.appearance->parameters();
    ASSERT_EQ(before.size(), after.size());
    for (size_t i = 0; i < after.size(); ++i) {
      EXPECT_TRUE(at::equal(before[i], after[i])) << preset.name << " " << i;
    }
    const Tensor number = at::arange(1, 5).to(at::kFloat), third = at::full({4}, 1.F / 3);
    const raster::SurfacePoints points = {r.object.mesh.vertices.narrow(0, 0, 4),
                                          at::stack({third, third, third, number}, 1)};
    EXPECT_TRUE(at::equal(r.object.appearance->color(points), back.appearance->color(points)))
        << preset.name;
    const Tensor curves = load_tensors(folder / "r.safetensors").get("curves", {2, 8}, at::kDouble);
    EXPECT_EQ(curves[1][1].item<double>(), r.curves[1].loss);
    EXPECT_EQ(curves[1][7].item<double>(), r.curves[1].success);
  }
}

TEST(Attack, UnknownNamesAreInputErrors) { EXPECT_THROW((void)attack_preset("dula"), InputError); }

}  // namespace
}  // namespace tt3d::attack
