// The MLPs in half precision: the bodies for tensor cores, run here by the CPU's team.

#include <ATen/ATen.h>
#include <ATen/Parallel.h>
#include <gtest/gtest.h>

#include "support/shapes.h"
#include "tt3d/field.h"

namespace tt3d::field {
namespace {

using at::Tensor;

Tensor rounded(const Tensor& t) { return t.to(at::kHalf).to(at::kFloat); }

std::vector<Tensor> network(std::vector<int64_t> widths) {
  std::vector<Tensor> weights;
  for (size_t k = 0; k + 1 < widths.size(); ++k) {
    const double bound = std::sqrt(6.0 / static_cast<double>(widths[k]));
    weights.push_back(
        testing::uniform({widths[k + 1], widths[k]}, -bound, bound, 1 + k).to(at::kFloat));
  }
  return weights;
}

struct Answer {
  Tensor y, grad_x;
  std::vector<Tensor> grad_weights;
};

template <typename Network>
Answer answer_of(const Network& run, const Tensor& x0, const std::vector<Tensor>& weights,
                 const Tensor& grad_out) {
  const Tensor x = x0.clone().requires_grad_(true);
  std::vector<Tensor> leaves;
  for (const Tensor& w : weights) leaves.push_back(w.clone().requires_grad_(true));
  const Tensor y = run(x, leaves);
  y.backward(grad_out);
  Answer answer{y.detach(), x.grad(), {}};
  for (const Tensor& leaf : leaves) answer.grad_weights.push_back(leaf.grad());
  return answer;
}

/// The same roundings in plain tensor operations.
Answer reference(const Tensor& x, const std::vector<Tensor>& weights, const Tensor& grad_out) {
  std::vector<Tensor> inputs = {rounded(x)};
  for (size_t k = 0; k + 1 < weights.size(); ++k) {
    inputs.push_back(rounded(rounded(weights[k]).mm(inputs[k]).relu()));
  }
  Answer answer{rounded(weights.back()).mm(inputs.back()), {}, {}};
  const double scale = std::exp2(std::floor(std::log2(256 / grad_out.abs().max().item<double>())));
  Tensor grad = rounded(grad_out * scale);
  for (size_t k = weights.size(); k-- > 0;) {
    answer.grad_weights.insert(answer.grad_weights.begin(), grad.mm(inputs[k].t()) / scale);
    grad = rounded(weights[k]).t().mm(grad);
    if (k > 0) grad = rounded(grad * (inputs[k] > 0));
  }
  answer.grad_x = grad / scale;
  return answer;
}

/// Compares lengths: a single point may lie at the kink of a ReLU, where its gradient jumps.
double relative(const Tensor& have, const Tensor& want) {
  EXPECT_EQ(have.sizes(), want.sizes());
  return ((have - want).to(at::kDouble).norm() / want.to(at::kDouble).norm()).item<double>();
}

void expect_close(const Answer& have, const Answer& want, double tolerance) {
  EXPECT_LT(relative(have.y, want.y), tolerance);
  EXPECT_LT(relative(have.grad_x, want.grad_x), tolerance);
  ASSERT_EQ(have.grad_weights.size(), want.grad_weights.size());
  for (size_t k = 0; k < want.grad_weights.size(); ++k) {
    EXPECT_LT(relative(have.grad_weights[k], want.grad_weights[k]), tolerance) << "layer " << k;
  }
}

TEST(HalfMlp, EqualsTheTensorReference) {
  // The field's three MLPs, and widths and counts that do not fill a tile or need several teams.
  for (const auto& widths : std::vector<std::vector<int64_t>>{
           {35, 64, 64, 6}, {19, 32, 1}, {6, 32, 3}, {1, 1}, {7, 19, 13, 33, 3}}) {
    for (const int64_t count : {1, 63, 64, 65, 1000, 64 * 512 + 7}) {
      const auto weights = network(widths);
      const Tensor x = testing::uniform({widths[0], count}, -1, 1, 9).to(at::kFloat);
      const Tensor grad = testing::uniform({widths.back(), count}, -1, 1, 10).to(at::kFloat);
      // Sums in another order may round an activation to the other neighbour.
      expect_close(answer_of(half_mlp, x, weights, grad), reference(x, weights, grad), 2e-3);
    }
  }
}

TEST(HalfMlp, FollowsTheNetworkInFloat32) {
  const auto weights = network({35, 64, 64, 6});
  const Tensor x = testing::uniform({35, 3000}, -1, 1, 9).to(at::kFloat);
  const Tensor unit = testing::uniform({6, 3000}, -1, 1, 10).to(at::kFloat);
  // Gradients far below the smallest number of float16, or far above its largest, keep their value.
  for (const double size : {1e-20, 1e-9, 1.0, 1e9}) {
    const Tensor grad = unit * size;
    expect_close(answer_of(half_mlp, x, weights, grad), answer_of(mlp, x, weights, grad), 2e-2);
  }
}

TEST(HalfMlp, StaysFiniteBeyondTheRange) {
  auto weights = network({8, 16, 3});
  weights[0] *= 1e6;
  const Tensor x = testing::uniform({8, 100}, -1, 1, 9).to(at::kFloat);
  const Answer a = answer_of(half_mlp, x, weights, at::ones({3, 100}));
  EXPECT_TRUE(a.y.isfinite().all().item<bool>());
  EXPECT_TRUE(a.grad_weights[0].isfinite().all().item<bool>());
  // NaN in the weights gives NaN in the result.
  weights[0][0][0] = std::numeric_limits<float>::quiet_NaN();
  EXPECT_TRUE(half_mlp(x, weights).isnan().any().item<bool>());
}

TEST(HalfMlp, NoGradientAndNoPoints) {
  const auto weights = network({8, 16, 3});
  const Tensor x = testing::uniform({8, 100}, -1, 1, 9).to(at::kFloat);
  const Answer still = answer_of(half_mlp, x, weights, at::zeros({3, 100}));
  EXPECT_EQ(still.grad_x.abs().max().item<double>(), 0);
  EXPECT_EQ(still.grad_weights[0].abs().max().item<double>(), 0);
  const Answer none = answer_of(half_mlp, x.narrow(1, 0, 0), weights, at::zeros({3, 0}));
  EXPECT_EQ(none.y.sizes(), at::IntArrayRef({3, 0}));
  EXPECT_EQ(none.grad_weights[1].abs().max().item<double>(), 0);
}

TEST(HalfMlp, SameBytesWithAnyThreads) {
  const auto weights = network({35, 64, 64, 6});
  const Tensor x = testing::uniform({35, 40000}, -1, 1, 9).to(at::kFloat);
  const Tensor grad = testing::uniform({6, 40000}, -1, 1, 10).to(at::kFloat);
  const int before = at::get_num_threads();
  at::set_num_threads(1);
  const Answer a = answer_of(half_mlp, x, weights, grad);
  at::set_num_threads(2);
  const Answer b = answer_of(half_mlp, x, weights, grad);
  at::set_num_threads(before);
  EXPECT_TRUE(at::equal(a.y, b.y));
  EXPECT_TRUE(at::equal(a.grad_x, b.grad_x));
  for (size_t k = 0; k < weights.size(); ++k) {
    EXPECT_TRUE(at::equal(a.grad_weights[k], b.grad_weights[k]));
  }
}

TEST(HalfMlp, RefusesWhatDoesNotFit) {
  EXPECT_THROW((void)half_mlp(at::zeros({200, 8}), network({200, 200, 200, 3})), c10::Error);
  EXPECT_THROW((void)half_mlp(at::zeros({4, 8}), network({4, 4, 4, 4, 4, 4})), c10::Error);
  EXPECT_THROW((void)half_mlp(at::zeros({4, 8}, at::kDouble), {at::zeros({3, 4}, at::kDouble)}),
               c10::Error);
}

}  // namespace
}  // namespace tt3d::field
