#pragma once

#include <gtest/gtest.h>

#include <functional>
#include <string>
#include <vector>

#include "support/shapes.h"
#include "tt3d/device.h"
#include "tt3d/error.h"

namespace tt3d::testing {

/// A test that needs a GPU; without one it is skipped with a message.
class OnGpu : public ::testing::Test {
 protected:
  void SetUp() override {
    try {
      gpu = device_named("cuda");
    } catch (const InputError& error) {
      GTEST_SKIP() << error.what();
    }
  }
  at::Device gpu = at::kCPU;
};

/// Largest difference relative to the largest expected value; non-finite values must be at the same
/// positions.
inline double relative_difference(const at::Tensor& expected, const at::Tensor& actual) {
  const at::Tensor a = expected.detach().cpu().to(at::kDouble);
  const at::Tensor b = actual.detach().cpu().to(at::kDouble);
  EXPECT_EQ(a.sizes(), b.sizes());
  if (a.numel() == 0) return 0;
  const at::Tensor finite = a.isfinite();
  EXPECT_TRUE(at::equal(finite, b.isfinite()));
  const at::Tensor zero = at::zeros({}, at::kDouble);
  const double scale = at::where(finite, a, zero).abs().max().item<double>();
  const double worst = at::where(finite, a - b, zero).abs().max().item<double>();
  return worst / (scale + 1e-30);
}

/// Length of the difference relative to the length of the expected values. For results where single
/// values may differ, e.g. if rounding moves a ReLU across its kink.
inline double relative_length(const at::Tensor& expected, const at::Tensor& actual) {
  const at::Tensor a = expected.detach().cpu().to(at::kDouble);
  const at::Tensor b = actual.detach().cpu().to(at::kDouble);
  EXPECT_EQ(a.sizes(), b.sizes());
  return (a - b).norm().item<double>() / (a.norm().item<double>() + 1e-30);
}

/// Results of a function of tensors on one device: its value, and the gradients of a fixed weighted
/// sum of it with respect to the floating-point inputs.
struct Outcome {
  at::Tensor value;
  std::vector<at::Tensor> gradients;
};
using TensorFunction = std::function<at::Tensor(const std::vector<at::Tensor>&)>;

inline Outcome outcome_on(const at::Device& device, const TensorFunction& function,
                          const std::vector<at::Tensor>& inputs) {
  std::vector<at::Tensor> moved;
  for (const at::Tensor& t : inputs) {
    moved.push_back(t.detach().to(device, t.scalar_type(), false, /*copy=*/true));
    if (moved.back().is_floating_point()) moved.back().requires_grad_(true);
  }
  Outcome result;
  const at::Tensor value = function(moved);
  EXPECT_EQ(value.device(), device);
  const at::Tensor weight = uniform(value.sizes(), -1, 1, 99).to(value.options());
  value.backward(weight);
  result.value = value.detach();
  for (const at::Tensor& t : moved) result.gradients.push_back(t.grad());
  return result;
}

/// Expects equal values and gradients on the CPU and on `gpu`, up to `tolerance` in `distance`.
inline void expect_same(const std::string& name, const at::Device& gpu,
                        const TensorFunction& function, const std::vector<at::Tensor>& inputs,
                        double tolerance,
                        double (*distance)(const at::Tensor&,
                                           const at::Tensor&) = relative_difference) {
  const Outcome a = outcome_on(at::kCPU, function, inputs), b = outcome_on(gpu, function, inputs);
  EXPECT_LE(distance(a.value, b.value), tolerance) << name;
  for (size_t i = 0; i < inputs.size(); ++i) {
    ASSERT_EQ(a.gradients[i].defined(), b.gradients[i].defined()) << name << ", input " << i;
    if (!a.gradients[i].defined()) continue;
    EXPECT_LE(distance(a.gradients[i], b.gradients[i]), tolerance)
        << name << ", gradient of input " << i;
  }
}

}  // namespace tt3d::testing
