#include <ATen/ATen.h>
#include <gtest/gtest.h>
#include <torch/csrc/autograd/autograd.h>

#include "model/package_tools.h"
#include "model/probe.h"
#include "tt3d/model.h"

namespace tt3d::model {
namespace {

ModelCard card_of(int64_t size, int64_t resize, const std::string& interpolation) {
  ModelCard card;
  card.name = "net";
  card.height = card.width = size;
  card.resize = resize;
  card.interpolation = interpolation;
  return card;
}

TEST(Preprocess, MatchesPillow) {
  const auto recorded = nlohmann::json::parse(read_file(testing::fixture("pillow.json")));
  const at::Tensor picture = model::probe_images(1, 40, 53, 5).mul(255).round().div(255);
  for (const std::string name : {"bilinear", "bicubic"}) {
    const auto pixels = recorded.at(name).get<std::vector<double>>();
    const at::Tensor expected = at::tensor(pixels, at::kDouble).view({1, 3, 24, 24}) / 255;
    const at::Tensor actual = preprocess(picture, card_of(24, 26, name));
    ASSERT_EQ(actual.sizes(), expected.sizes());
    const at::Tensor difference = (actual - expected).abs();
    EXPECT_LT(difference.mean().item<double>(), 0.5 / 255) << name;
    EXPECT_LT(difference.max().item<double>(), 2.0 / 255) << name;
  }
}

TEST(Preprocess, AnySizeAndBatch) {
  for (const auto& [h, w] : {std::pair{400, 400}, {30, 200}, {17, 16}, {256, 100}}) {
    const at::Tensor pictures = at::rand({3, 3, h, w});
    const at::Tensor out = preprocess(pictures, card_of(24, 26, "bicubic"));
    EXPECT_EQ(out.sizes(), at::IntArrayRef({3, 3, 24, 24}));
    EXPECT_GE(out.min().item<float>(), 0.0F);
    EXPECT_LE(out.max().item<float>(), 1.0F);
  }
}

TEST(Preprocess, SameSizeIsTheSamePicture) {
  const at::Tensor pictures = at::rand({2, 3, 24, 24});
  EXPECT_TRUE(preprocess(pictures, card_of(24, 24, "bicubic")).equal(pictures));
}

TEST(Preprocess, GradientAgainstCentralDifferences) {
  const ModelCard card = card_of(6, 7, "bilinear");
  at::Tensor pictures = at::rand({1, 3, 20, 23}).requires_grad_(true);
  const at::Tensor direction = at::rand({1, 3, 6, 6});
  const auto gradient =
      torch::autograd::grad({(preprocess(pictures, card) * direction).sum()}, {pictures})[0];
  const at::Tensor step = at::randn(pictures.sizes());
  const at::NoGradGuard no_gradients;
  // The map is linear, so any step size gives the derivative.
  const double change =
      ((preprocess(pictures + step, card) - preprocess(pictures - step, card)) * direction)
          .sum()
          .item<double>() /
      2;
  EXPECT_NEAR((gradient * step).sum().item<double>(), change, 1e-3 * std::abs(change) + 1e-3);
}

TEST(Preprocess, RefusesOtherTensors) {
  const ModelCard card = card_of(24, 26, "bilinear");
  EXPECT_THROW((void)preprocess(at::rand({3, 24, 24}), card), InputError);
  EXPECT_THROW((void)preprocess(at::rand({1, 4, 24, 24}), card), InputError);
  EXPECT_THROW((void)preprocess(at::rand({1, 3, 24, 24}, at::kDouble), card), InputError);
}

}  // namespace
}  // namespace tt3d::model
