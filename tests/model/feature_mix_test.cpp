#include <ATen/ATen.h>
#include <gtest/gtest.h>
#include <torch/csrc/autograd/autograd.h>

#include "model/feature_mixer.h"
#include "model/package_tools.h"
#include "tt3d/model.h"
#include "tt3d/random_tensor.h"

namespace tt3d::model {
namespace {

std::shared_ptr<Classifier> toy_classifier(const std::string& name,
                                           int64_t bytes = int64_t{1} << 30) {
  ModelLimits limits;
  limits.intermediate_bytes = bytes;
  ModelOptions options;
  options.check_probe = false;
  return Classifier::load(testing::fixture(name + ".pt2").string(), limits, nullptr, options);
}

FeatureMix mix_of(const at::Tensor& competitors, double probability = 0.5) {
  FeatureMix mix;
  mix.images = competitors;
  mix.probability = probability;
  mix.seed = 3;
  mix.step = 7;
  return mix;
}

TEST(FeatureMix, IsAShareOfEachChannelByHand) {
  const at::Tensor own = at::rand({2, 4, 3, 3}), others = at::rand({2, 4, 3, 3});
  const FeatureMix mix = mix_of(at::zeros({2, 3, 8, 8}), 1);
  model::FeatureMixer mixer(mix, 0);
  EXPECT_TRUE(mixer.take(0, others, true).equal(others));
  mixer.begin_mixing();
  const at::Tensor mixed = mixer.take(0, own, true);
  const at::Tensor shares = (mixed - own) / (others - own);
  const at::Tensor first = shares.select(3, 0).select(2, 0).unsqueeze(2).unsqueeze(3);
  EXPECT_TRUE(at::allclose(shares, first.expand_as(shares), 1e-2, 1e-3));
  EXPECT_GE(shares.min().item<float>(), -1e-3);
  EXPECT_LT(shares.max().item<float>(), 0.751);
  EXPECT_GT(first.std().item<float>(), 0.05);  // weights differ per channel and picture
  const RandomKey key = Random(mix.seed, "model/mix/0", mix.step).key();
  EXPECT_TRUE(
      at::allclose(first, uniform_tensor({2, 4, 1, 1}, 0, 0.75, key, at::kCPU), 1e-2, 1e-3));
  // The features of a linear layer are the last dimension.
  model::FeatureMixer linear(mix, 0);
  (void)linear.take(0, at::ones({2, 5, 6}), false);
  linear.begin_mixing();
  const at::Tensor tokens = linear.take(0, at::zeros({2, 5, 6}), false);
  EXPECT_TRUE(tokens.equal(tokens.narrow(1, 0, 1).expand_as(tokens)));
  EXPECT_GT(tokens.std().item<float>(), 0.05);
}

TEST(FeatureMix, ChoosesLayersByItsProbability) {
  constexpr int64_t kLayers = 2000;
  const FeatureMix mix = mix_of(at::zeros({1, 3, 8, 8}), 0.1);
  model::FeatureMixer mixer(mix, 0);
  for (int64_t i = 0; i < kLayers; ++i) (void)mixer.take(i, at::ones({1, 1}), false);
  mixer.begin_mixing();
  int64_t mixed = 0;
  for (int64_t i = 0; i < kLayers; ++i) {
    mixed += mixer.take(i, at::zeros({1, 1}), false).item<float>() > 0 ? 1 : 0;
  }
  EXPECT_NEAR(static_cast<double>(mixed) / kLayers, 0.1, 0.03);
}

TEST(FeatureMix, PicturesAmongThemselvesAndWithoutLayersStayAsTheyAre) {
  for (const char* name : {"toy_cnn", "toy_vit"}) {
    const auto model = toy_classifier(name);
    const at::Tensor images = at::rand({3, 3, 16, 16}), others = at::rand({3, 3, 16, 16});
    const at::Tensor plain = model->logits(images);
    // Mixed pictures run step by step; the others may run compiled, which rounds differently.
    const auto near = [&](const at::Tensor& logits) {
      return at::allclose(logits, plain, 1e-5, 1e-5);
    };
    EXPECT_TRUE(near(model->mixed_logits(images, mix_of(images, 1)))) << name;
    EXPECT_TRUE(near(model->mixed_logits(images, mix_of(others, 0)))) << name;
    const at::Tensor mixed = model->mixed_logits(images, mix_of(others, 1));
    EXPECT_FALSE(at::allclose(mixed, plain, 1e-2, 1e-3)) << name;
    EXPECT_TRUE(model->mixed_logits(images, mix_of(others, 1)).equal(mixed)) << name;
    FeatureMix next = mix_of(others, 1);
    ++next.step;
    EXPECT_FALSE(model->mixed_logits(images, next).equal(mixed)) << name;
  }
}

TEST(FeatureMix, GradientsReachThePicturesAloneAndAreRight) {
  const auto model = toy_classifier("toy_cnn");
  const at::Tensor images = at::rand({2, 3, 16, 16}).requires_grad_(true);
  const at::Tensor others = at::rand({2, 3, 16, 16}).requires_grad_(true);
  const FeatureMix mix = mix_of(others, 1);
  const at::Tensor weight = at::linspace(-1, 1, 7);
  const auto value = [&](const at::Tensor& x) {
    return (model->mixed_logits(x, mix) * weight).sum();
  };
  value(images).backward();
  EXPECT_FALSE(others.grad().defined());
  const at::NoGradGuard guard;
  const at::Tensor way = images.grad() / images.grad().norm();
  constexpr double kStep = 1e-2;
  const double slope = (value(images + kStep * way) - value(images - kStep * way)).item<double>();
  EXPECT_NEAR(slope / (2 * kStep) / images.grad().norm().item<double>(), 1, 0.02);
}

TEST(FeatureMix, BatchesInPartsGiveTheSame) {
  for (const char* name : {"toy_cnn", "toy_vit"}) {
    const at::Tensor images = at::rand({13, 3, 16, 16}), others = at::rand({13, 3, 16, 16});
    std::vector<at::Tensor> logits, gradients;
    for (const int64_t bytes : {int64_t{1} << 30, int64_t{150000}}) {
      const auto model = toy_classifier(name, bytes);
      const at::Tensor leaf = images.clone().requires_grad_(true);
      logits.push_back(model->mixed_logits(leaf, mix_of(others, 1)));
      (logits.back() * at::arange(7)).sum().backward();
      gradients.push_back(leaf.grad());
    }
    EXPECT_TRUE(at::allclose(logits[0], logits[1], 1e-4, 1e-5)) << name;
    EXPECT_TRUE(at::allclose(gradients[0], gradients[1], 1e-3, 1e-6)) << name;
  }
}

TEST(FeatureMix, WantsACompetitorForEachPicture) {
  const auto model = toy_classifier("toy_cnn");
  EXPECT_THROW(
      (void)model->mixed_logits(at::rand({2, 3, 16, 16}), mix_of(at::rand({3, 3, 16, 16}))),
      InputError);
}

}  // namespace
}  // namespace tt3d::model
