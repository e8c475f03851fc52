#include <ATen/ATen.h>
#include <ATen/cpu/Utils.h>
#include <gtest/gtest.h>
#include <torch/csrc/autograd/autograd.h>

#include "model/package_tools.h"
#include "tt3d/model.h"

namespace tt3d::model {
namespace {

using testing::toy;

ModelOptions reduced(Precision precision, bool allow_slow) {
  ModelOptions options;
  options.precision = precision;
  options.allow_slow = allow_slow;
  return options;
}

std::string error_of(const ModelOptions& options) {
  try {
    (void)Classifier::load(toy("toy_cnn"), {}, nullptr, options);
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

double cosine(const at::Tensor& a, const at::Tensor& b) {
  return ((a * b).sum() / (a.norm() * b.norm())).item<double>();
}

TEST(Precision, Bfloat16StaysNearFloat32) {
  for (const std::string name : {"toy_cnn", "toy_vit"}) {
    const auto exact = Classifier::load(toy(name));
    const auto model =
        Classifier::load(toy(name), {}, nullptr, reduced(Precision::kBfloat16, true));
    std::vector<at::Tensor> logits, gradients;
    for (const auto& one : {exact, model}) {
      const at::Tensor images = at::linspace(0, 1, 3 * 3 * 256).view({3, 3, 16, 16});
      const at::Tensor leaf = images.clone().requires_grad_(true);
      logits.push_back(one->logits(leaf));
      gradients.push_back(torch::autograd::grad({logits.back().square().sum()}, {leaf})[0]);
    }
    EXPECT_EQ(logits[1].scalar_type(), at::kFloat);
    const at::Tensor range = logits[0].max() - logits[0].min();
    const at::Tensor difference = (logits[1] - logits[0]).abs().max() / range;
    EXPECT_LT(difference.item<double>(), 0.05) << name;
    EXPECT_FALSE(gradients[0].equal(gradients[1])) << name << ": float32 all the same";
    EXPECT_GT(cosine(gradients[0], gradients[1]), 0.99) << name;
  }
}

TEST(Precision, RefusedWhereItWouldBeSlower) {
  if (at::hasCUDA()) GTEST_SKIP() << "a CUDA device has both";
  EXPECT_NE(error_of(reduced(Precision::kTf32, false)).find("CUDA"), std::string::npos);
  const auto capabilities = at::cpu::get_cpu_capabilities();
  const bool fast = capabilities.at("avx512_bf16").toBool() || capabilities.at("amx_bf16").toBool();
  const std::string error = error_of(reduced(Precision::kBfloat16, false));
  EXPECT_EQ(error.empty(), fast);
  if (!fast) {
    EXPECT_NE(error.find("AVX512-BF16"), std::string::npos) << error;
  }
}

}  // namespace
}  // namespace tt3d::model
