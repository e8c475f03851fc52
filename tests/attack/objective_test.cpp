#include <gtest/gtest.h>

#include <cmath>

#include "attack/ensemble.h"
#include "attack/toy_attack.h"
#include "support/gradient_check.h"
#include "tt3d/attack.h"

namespace tt3d::attack {
namespace {

using at::Tensor;
using testing::value;

TEST(Objective, EqualsAComputationByHand) {
  const Tensor logits = at::tensor({1.F, 2.F, 4.F}).view({1, 3});
  const auto targeted = [&](Objective objective, int64_t index) {
    return value(objective_loss(objective, Goal::kTargeted, logits, index));
  };
  EXPECT_NEAR(targeted(Objective::kLogit, 1), -2, 1e-6);
  // log(e + e^2 + e^4) - 4 and log(e^2 + e^4) - 1.
  EXPECT_NEAR(targeted(Objective::kCrossEntropy, 2), 0.16984, 1e-4);
  EXPECT_NEAR(targeted(Objective::kMargin, 0), 3.12693, 1e-4);
}

TEST(Objective, UntargetedIsTheNegatedTargetedLoss) {
  const Tensor logits = testing::uniform({4, 5}, -3, 3, 1);
  for (const std::string& name : names_of<Objective>()) {
    const auto objective = parse_enum<Objective>(name);
    EXPECT_EQ(value(objective_loss(objective, Goal::kUntargeted, logits, 2)),
              -value(objective_loss(objective, Goal::kTargeted, logits, 2)))
        << name;
  }
}

TEST(Objective, GradientsAgainstCentralDifferences) {
  for (const std::string& name : names_of<Objective>()) {
    for (const Goal goal : {Goal::kTargeted, Goal::kUntargeted}) {
      const auto objective = parse_enum<Objective>(name);
      EXPECT_LT(testing::gradient_error(
                    [&](const std::vector<Tensor>& in) {
                      return objective_loss(objective, goal, in[0], 1);
                    },
                    {testing::uniform({3, 4}, -2, 2, 5)}),
                1e-6)
          << name << " " << name_of(goal);
    }
  }
}

TEST(Objective, UnknownNamesAreInputErrors) {
  EXPECT_THROW((void)parse_enum<Objective>("logits"), InputError);
  EXPECT_THROW((void)parse_enum<Goal>("aimed"), InputError);
}

/// Two surrogates with different answers, pictures for them, and no transforms.
struct Pair : ::testing::Test {
  Pair() {
    input.surrogates = {std::make_shared<testing::ColorClassifier>(40),
                        std::make_shared<testing::ColorClassifier>(7)};
    input.classes = {1, 1};
    options.objective.loss = Objective::kCrossEntropy;
    options.naturalness.psnr_floor = options.naturalness.ssim_floor = 0;
    options.eot = testing::no_transforms();
    pictures = testing::uniform({2, 4, 32, 32}, 0.2, 0.8, 3).to(at::kFloat);
    pictures.select(1, 3).fill_(1);
    pictures.requires_grad_(true);
  }

  /// Loss of these surrogates, and its gradient with respect to the pictures.
  std::pair<double, Tensor> ask(const std::vector<size_t>& models) {
    AttackInput part = input;
    part.surrogates.clear();
    part.classes.clear();
    for (const size_t m : models) {
      part.surrogates.push_back(input.surrogates[m]);
      part.classes.push_back(input.classes[m]);
    }
    std::vector<Tensor> hits;
    const Tensor loss = Ensemble(part, options, 1).loss(pictures, {}, 0, hits);
    EXPECT_EQ(hits.size(), models.size());
    return {value(loss), torch::autograd::grad({loss}, {pictures})[0]};
  }

  AttackInput input = testing::ball_input(1);
  AttackOptions options;
  Tensor pictures;
};

TEST_F(Pair, MeanOfLosses) {
  options.objective.ensemble = EnsembleMode::kLosses;
  const auto both = ask({0, 1}), first = ask({0}), second = ask({1});
  EXPECT_NEAR(both.first, (first.first + second.first) / 2, 1e-6);
  EXPECT_TRUE(at::allclose(both.second, (first.second + second.second) / 2, 1e-4, 1e-9));
}

TEST_F(Pair, MeanOfLogits) {
  options.objective.ensemble = EnsembleMode::kLogits;
  const Tensor means = pictures.detach().narrow(1, 0, 3).mean({2, 3});
  const Tensor logits = means * ((40 + 7) / 2.0);
  EXPECT_NEAR(ask({0, 1}).first,
              value(objective_loss(Objective::kCrossEntropy, Goal::kTargeted, logits, 1)), 1e-3);
}

TEST_F(Pair, MeanOfGradientsOfLengthOne) {
  options.objective.ensemble = EnsembleMode::kGradients;
  const auto both = ask({0, 1});
  const Tensor first = ask({0}).second, second = ask({1}).second;
  EXPECT_NEAR(value(first.norm()), 1, 1e-5);
  EXPECT_NEAR(value(second.norm()), 1, 1e-5);
  EXPECT_TRUE(at::allclose(both.second, (first + second) / 2, 1e-4, 1e-9));
  // The gradient keeps the direction of the surrogate, and the loss is unchanged.
  options.objective.ensemble = EnsembleMode::kLosses;
  EXPECT_NEAR(testing::cosine(ask({1}).second, second), 1, 1e-6);
  EXPECT_NEAR(ask({0, 1}).first, both.first, 1e-6);
}

TEST_F(Pair, EachViewGoesToOneSurrogateInTurn) {
  options.objective.ensemble = EnsembleMode::kViews;
  const auto both = ask({0, 1});
  const auto first = ask({0}), second = ask({1});
  // Picture 0 goes to the first surrogate, picture 1 to the second.
  const Tensor dealt = at::stack({first.second[0], second.second[1]});
  EXPECT_TRUE(at::allclose(both.second, dealt, 1e-4, 1e-9));
}

TEST_F(Pair, WithFewerViewsThanSurrogatesEachIsUsedInTurn) {
  options.objective.ensemble = EnsembleMode::kViews;
  const Tensor one = pictures.narrow(0, 0, 1);
  const Ensemble ensemble(input, options, 1);
  std::vector<double> turns;
  for (int64_t step = 0; step < 3; ++step) {
    std::vector<Tensor> hits;
    turns.push_back(value(ensemble.loss(one, {}, step, hits)));
    EXPECT_EQ(hits.size(), 1U);
  }
  EXPECT_NE(turns[0], turns[1]);
  EXPECT_EQ(turns[0], turns[2]);
}

TEST_F(Pair, OnlyTheMeanOfLogitsNeedsTheSameLabels) {
  input.surrogates[1] = std::make_shared<testing::ColorClassifier>(
      7, std::vector<std::string>{"blue", "green", "red"});
  options.objective.ensemble = EnsembleMode::kGradients;
  EXPECT_NO_THROW(ask({0, 1}));
  options.objective.ensemble = EnsembleMode::kLogits;
  EXPECT_THROW(ask({0, 1}), InputError);
}

TEST_F(Pair, NeedsSurrogates) { EXPECT_THROW(ask({}), InputError); }

TEST(GradientOfLength, ZeroStaysZero) {
  const Tensor x = at::ones({3}).requires_grad_(true);
  const Tensor loss = (with_gradient_of_length(x, 2) * 0).sum();
  EXPECT_EQ(value(torch::autograd::grad({loss}, {x})[0].abs().sum()), 0);
}

}  // namespace
}  // namespace tt3d::attack
