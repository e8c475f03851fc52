#include "tt3d/attack.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "attack/attacker.h"
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
    if (!testing::frees_colors(o)) continue;  // shape or a patch is not enough
    for (const int64_t target : {0, 2}) {
      testing::TemporaryFolder folder;
      const AttackResult r = run_attack(ball_input(target), o, 1, folder / "c", quiet);
      EXPECT_GE(late_success(r), 0.8) << preset.name << " " << target;
    }
  }
}

bool contains(const std::vector<std::string>& words, const std::string& word) {
  return std::find(words.begin(), words.end(), word) != words.end();
}

TEST(Attack, OnlyThePresetsParametersMove) {
  Progress quiet;
  const AttackInput input = ball_input(1);
  for (const AttackPreset& preset : attack_presets()) {
    testing::TemporaryFolder folder;
    AttackOptions o = toy_options(preset);
    o.steps = 5;
    const AttackResult r = run_attack(input, o, 1, folder / "c", quiet);
    EXPECT_EQ(at::equal(r.mesh.vertices, input.mesh.vertices), !contains(o.optimize, "vertices"))
        << preset.name;
    EXPECT_TRUE(at::equal(r.mesh.faces, input.mesh.faces));
    const auto start = starting_look(input, o);
    const auto clean = start->groups(), moved = r.appearance->groups();
    ASSERT_EQ(moved.size(), clean.size());
    for (size_t g = 0; g < moved.size(); ++g) {
      for (size_t i = 0; i < moved[g].tensors.size(); ++i) {
        EXPECT_EQ(at::equal(moved[g].tensors[i], clean[g].tensors[i]),
                  !contains(o.optimize, moved[g].name))
            << preset.name << " " << moved[g].name;
      }
    }
  }
}

TEST(Attack, PartsThatDoNotGoTogetherAreInputErrors) {
  Progress quiet;
  testing::TemporaryFolder folder;
  for (const std::vector<std::string>& parts :
       {std::vector<std::string>{"grid", "vertex-colors"}, {}, {"texture", "tile"}, {"textures"}}) {
    AttackOptions o = toy_options();
    o.optimize = parts;
    EXPECT_THROW((void)run_attack(ball_input(0), o, 1, folder / "c", quiet), InputError);
  }
}

TEST(Attack, ATextureNeedsAMapAndATileAMapping) {
  AttackInput input = ball_input(0);
  AttackOptions o = toy_options(attack_preset("triplanar"));
  EXPECT_FALSE(needs_texture_map(o));
  o.tile_mapping = "spherical";
  EXPECT_THROW((void)starting_look(input, o), InputError);
  input.map = {};
  for (const char* preset : {"texture", "repeated"}) {
    o = toy_options(attack_preset(preset));
    EXPECT_TRUE(needs_texture_map(o)) << preset;
    EXPECT_THROW((void)starting_look(input, o), InputError) << preset;
  }
}

TEST(Attack, UntargetedLeavesTheClass) {
  Progress quiet;
  testing::TemporaryFolder folder;
  const AttackInput input = ball_input(0);
  AttackOptions o = toy_options();
  const AttackResult red = run_attack(input, o, 1, folder / "red", quiet);
  ASSERT_GE(late_success(red), 0.9);
  // From the red ball away from red.
  AttackInput from_red = input;
  from_red.mesh = red.mesh;
  from_red.appearance = red.appearance;
  o.goal = "untargeted";
  o.steps = 120;
  const AttackResult r = run_attack(from_red, o, 1, folder / "c", quiet);
  EXPECT_LE(r.curves.front().success, 0.5);
  EXPECT_GE(late_success(r), 0.9);
}

TEST(Attack, StrongerBetaStaysNearerToTheCleanObject) {
  Progress quiet;
  double before = 1e9;
  for (const double beta : {0.0, 1e3, 1e5}) {
    testing::TemporaryFolder folder;
    AttackOptions o = toy_options();
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
    AttackOptions o = toy_options();
    o.beta = 1e3;
    o.rgb_weight = 0;
    o.ssim_floor = floor;
    distance.push_back(run_attack(ball_input(0), o, 1, folder / "c", quiet).curves.back().rgb);
  }
  EXPECT_LT(distance[1], 0.5 * distance[0]);
}

TEST(Attack, MomentumGathersScaledGradients) {
  // Two steps on known gradients; Adam then moves along the velocity.
  AttackOptions o = toy_options();
  o.optimize = {"vertices"};
  o.momentum = 0.5;
  const AttackInput input = ball_input(0);
  const Attacker attacker(input, o, 1);
  AttackState s = attacker.fresh();
  Tensor first = at::zeros_like(input.mesh.vertices), second = at::zeros_like(first);
  const auto count = static_cast<double>(first.numel());
  first[0][0] = 3;  // scaled to a mean length of 1: count
  second[0][0] = -1;
  second[1][0] = 1;  // count / 2 each
  attacker.apply({first}, s);
  EXPECT_NEAR(s.velocity[0][0][0].item<double>(), count, 1e-3 * count);
  attacker.apply({second}, s);
  EXPECT_NEAR(s.velocity[0][0][0].item<double>(), 0, 1e-3 * count);
  EXPECT_NEAR(s.velocity[0][1][0].item<double>(), count / 2, 1e-3 * count);
}

/// Remembers what competed with the pictures.
class MixWitness : public testing::ColorClassifier {
 public:
  [[nodiscard]] Tensor mixed_logits(const Tensor& images, const FeatureMix& mix) const override {
    seen = images.detach();
    competitors = mix;
    return logits(images);
  }
  mutable Tensor seen;
  mutable FeatureMix competitors;
};

TEST(Attack, TheCleanObjectInTheSameViewsCompetes) {
  Progress quiet;
  AttackInput input = ball_input(0);
  const auto witness = std::make_shared<MixWitness>();
  input.surrogates = {witness};
  AttackOptions o = toy_options();
  o.eot = testing::no_transforms();
  o.feature_mix = 0.3;
  o.feature_mix_share = 0.6;
  o.steps = 1;
  testing::TemporaryFolder folder;
  (void)run_attack(input, o, 1, folder / "one", quiet);
  EXPECT_EQ(witness->competitors.probability, 0.3);
  EXPECT_EQ(witness->competitors.share, 0.6);
  EXPECT_FALSE(witness->competitors.images.requires_grad());
  EXPECT_TRUE(at::allclose(witness->competitors.images, witness->seen));  // nothing changed yet
  o.steps = 20;
  (void)run_attack(input, o, 1, folder / "more", quiet);
  const Tensor own = witness->seen.mean({0, 2, 3}),
               other = witness->competitors.images.mean({0, 2, 3});
  EXPECT_GT(own[0].item<float>(), other[0].item<float>() + 0.01F);  // redder than the clean ball
}

TEST(Attack, SchedulesGoFromOneToTheFinalRate) {
  AttackOptions o;
  o.final_rate = 0.2;
  for (const std::string& name : schedule_names()) {
    o.schedule = name;
    EXPECT_NEAR(rate_share(o, 0), 1, 1e-12) << name;
    EXPECT_NEAR(rate_share(o, 1), 0.2, 1e-12) << name;
  }
  o.schedule = "cosine";
  EXPECT_NEAR(rate_share(o, 0.5), 0.6, 1e-12);
  EXPECT_NEAR(rate_share(o, 1.0 / 3), 0.8, 1e-12);
  o.schedule = "linear";
  EXPECT_THROW((void)rate_share(o, 0), InputError);
}

TEST(Attack, ResumedAfterAnyStopGivesTheSameBytes) {
  Progress quiet;
  const AttackInput input = ball_input(0);
  for (const char* preset : {"dual", "mesh", "strong"}) {
    testing::TemporaryFolder folder;
    AttackOptions o = toy_options(attack_preset(preset));
    if (preset == std::string("mesh")) o.epoch = 4, o.held_out_views = 3;
    if (preset == std::string("strong")) o.feature_mix = 0.5;
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
    EXPECT_EQ(read_file(folder / "a.safetensors"), read_file(folder / "b.safetensors")) << preset;
    EXPECT_EQ(epochs_csv(whole.epochs), epochs_csv(again.epochs));
  }
}

// ---- Several objects ----------------------------------------------------------------------

/// The toy ball stretched along an axis.
AttackInput stretched_ball(int64_t target, int64_t axis, double by) {
  AttackInput input = ball_input(target);
  Tensor scale = at::ones({3});
  scale[axis] = by;
  input.mesh.vertices = input.mesh.vertices * scale;
  return input;
}

/// Success of a look on an object, by an attack that cannot move.
double success_of(const std::shared_ptr<const Appearance>& look, AttackInput input) {
  Progress quiet;
  testing::TemporaryFolder folder;
  input.appearance = look;
  input.also.clear();
  AttackOptions o = toy_options();
  o.optimize = {"vertices"};
  o.vertex_rate = 1e-12;
  o.steps = 10;
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
    const AttackResult worn = worn_result(r, other);
    EXPECT_TRUE(at::equal(worn.mesh.vertices, other.mesh.vertices));
    EXPECT_TRUE(at::equal(worn.appearance->parameters()[0], r.appearance->parameters()[0]));
    const double before = success_of(starting_look(other, o), other);
    EXPECT_GE(success_of(worn.appearance, other), std::max(0.9, before + 0.1));
  }
}

TEST(Universal, GradientsAreTheMeanOverTheObjects) {
  AttackInput one = ball_input(0), two = stretched_ball(0, 0, 0.5), both = one;
  both.also = {two};
  AttackOptions o = toy_options(attack_preset("triplanar"));
  std::vector<Tensor> grads[3];
  AttackCurvePoint points[3];
  AttackInput* inputs[3] = {&one, &two, &both};
  // One tile for all three, as the tiles they start with differ by their objects' mean colour.
  const Tensor tile = at::full({o.tile_size, o.tile_size, 3}, 0.4);
  for (int i = 0; i < 3; ++i) {
    const Attacker attacker(*inputs[i], o, 1);
    const AttackState s = attacker.fresh();
    at::NoGradGuard guard;
    s.appearance->parameters()[0].copy_(tile);
    at::AutoGradMode on(true);
    points[i] = attacker.compute(s, grads[i]);
  }
  EXPECT_TRUE(at::allclose(grads[2][0], (grads[0][0] + grads[1][0]) / 2, 1e-5, 1e-7));
  EXPECT_NEAR(points[2].objective, (points[0].objective + points[1].objective) / 2, 1e-9);
}

TEST(Universal, LooksOfOneObjectAndShapesAreInputErrors) {
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

/// The toy attack in epochs.
AttackOptions epochs_of_five() {
  AttackOptions o = toy_options();
  o.epoch = 5;
  o.held_out_views = 3;
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
  // Scoring draws from a stream of its own: the steps are those of an attack without epochs.
  o.epoch = 0;
  const AttackResult plain = run_attack(input, o, 1, folder / "d", quiet);
  EXPECT_EQ(curves_csv(plain.curves), curves_csv(r.curves));
  EXPECT_TRUE(plain.epochs.empty());
  EXPECT_EQ(epochs_csv({{5, -1.5, 0.25, 0.5}}),
            "step,objective,success,held_out\n5,-1.5,0.2500,0.5000\n");
}

TEST(Epochs, WithoutProgressTheAttackStops) {
  // Nothing moves at this rate, so no epoch is better than the first.
  Progress quiet;
  testing::TemporaryFolder folder;
  AttackOptions o = epochs_of_five();
  o.appearance_rate = o.vertex_rate = 1e-12;
  o.patience = 3;
  const AttackResult r = run_attack(ball_input(0), o, 1, folder / "c", quiet);
  EXPECT_EQ(r.epochs.size(), 4U);
  EXPECT_EQ(r.curves.size(), 20U);
}

/// A classifier that goes over to the other answer after a number of batches.
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

TEST(Epochs, AWorseEndGivesWayToTheBestState) {
  Progress quiet;
  testing::TemporaryFolder folder;
  AttackOptions o = epochs_of_five();
  o.epoch = 10;
  o.steps = 30;
  o.final_rate = 1;  // steps do not depend on how many there will be
  // Ten steps and two batches of held-out views an epoch: 24 calls later the truth turns, and what
  // the next epoch scores is worse than before.
  AttackInput input = ball_input(0);
  input.surrogates = {std::make_shared<TurningClassifier>(24)};
  const AttackResult r = run_attack(input, o, 1, folder / "c", quiet);
  ASSERT_EQ(r.epochs.size(), 3U);
  ASSERT_LT(r.epochs[2].held_out, r.epochs[1].held_out);
  // What it gives is what it had after 20 steps.
  o.steps = 20;
  o.epoch = 0;
  const AttackResult at_best = run_attack(ball_input(0), o, 1, folder / "d", quiet);
  EXPECT_TRUE(at::equal(r.mesh.vertices, at_best.mesh.vertices));
  EXPECT_TRUE(at::equal(r.appearance->parameters()[0], at_best.appearance->parameters()[0]));
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
  const AttackResult r = run_attack(input, toy_options(), 1, folder / "c", notes);
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
  EXPECT_THROW((void)run_attack(input, toy_options(), 1, folder / "c", notes), NumericError);
  EXPECT_EQ(notes.count, 3);
}

/// A classifier on a device that holds two pictures at a time.
class SmallClassifier : public testing::ColorClassifier {
 public:
  [[nodiscard]] Tensor logits(const Tensor& images) const override {
    if (images.size(0) > 2) C10_THROW_ERROR(OutOfMemoryError, "no more than two pictures");
    return ColorClassifier::logits(images);
  }
};

TEST(Attack, OutOfMemoryHalvesTheViewsAndTheWorkGoesOn) {
  testing::TemporaryFolder folder;
  AttackInput input = ball_input(0);
  input.surrogates = {std::make_shared<SmallClassifier>()};
  AttackOptions o = toy_options();
  o.views_per_step = 8;
  testing::CountNotes notes;
  const AttackResult r = run_attack(input, o, 1, folder / "c", notes);
  EXPECT_EQ(notes.count, 2);  // to four, to two, and never again
  EXPECT_EQ(r.curves.size(), 40U);
  EXPECT_GE(late_success(r), 0.9);
}

TEST(Attack, OutOfMemoryWithOneViewIsAnErrorThatSaysWhatToDo) {
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

TEST(Attack, EveryPresetIsSavedAndLoaded) {
  Progress quiet;
  for (const AttackPreset& preset : attack_presets()) {
    testing::TemporaryFolder folder;
    AttackOptions o = toy_options(preset);
    o.steps = 2;
    const AttackResult r = run_attack(ball_input(0), o, 1, folder / "c", quiet);
    save_attack(r, folder / "r.safetensors");
    const AttackResult back = load_attack(folder / "r.safetensors");
    EXPECT_TRUE(at::equal(r.mesh.vertices, back.mesh.vertices));
    const auto before = r.appearance->parameters(), after = back.appearance->parameters();
    ASSERT_EQ(before.size(), after.size());
    for (size_t i = 0; i < after.size(); ++i) {
      EXPECT_TRUE(at::equal(before[i], after[i])) << preset.name << " " << i;
    }
    const Tensor number = at::arange(1, 5).to(at::kFloat), third = at::full({4}, 1.F / 3);
    const SurfacePoints points = {r.mesh.vertices.narrow(0, 0, 4),
                                  at::stack({third, third, third, number}, 1)};
    EXPECT_TRUE(at::equal(r.appearance->color(points), back.appearance->color(points)))
        << preset.name;
    EXPECT_EQ(curves_csv(r.curves), curves_csv(back.curves));
  }
}

TEST(Attack, UnknownNamesAreInputErrors) { EXPECT_THROW((void)attack_preset("dula"), InputError); }

}  // namespace
}  // namespace tt3d
