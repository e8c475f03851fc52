// The MLP bodies for every vector width: the machine picks one at load time, this test checks all.

#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include "mlp_math.h"
#include "support/shapes.h"

namespace tt3d::field {
namespace {

using at::Tensor;

constexpr int64_t kCount = 300;  // two whole blocks and a partial one

struct Passes {
  Tensor y, grad_x;
  std::vector<Tensor> grad_weights;
};

Passes passes_of_tensors(const Tensor& x0, const std::vector<Tensor>& weights,
                         const Tensor& grad_out) {
  Tensor x = x0.clone().requires_grad_(true), y = x;
  std::vector<Tensor> leaves;
  for (size_t k = 0; k < weights.size(); ++k) {
    leaves.push_back(weights[k].clone().requires_grad_(true));
    y = leaves.back().matmul(y);
    if (k + 1 < weights.size()) y = y.relu();
  }
  (y * grad_out).sum().backward();
  Passes answer{y.detach(), x.grad(), {}};
  for (const Tensor& leaf : leaves) answer.grad_weights.push_back(leaf.grad());
  return answer;
}

template <typename T, int kVectorBytes>
Passes passes_of_kernel(const Tensor& x, const std::vector<Tensor>& weights,
                        const Tensor& grad_out) {
  std::vector<Layer<T>> layers;
  std::vector<Tensor> turned, sums;
  std::vector<const T*> transposed;
  std::vector<T*> grad_weights;
  for (const Tensor& w : weights) {
    layers.push_back({w.const_data_ptr<T>(), w.size(1), w.size(0)});
    turned.push_back(w.t().contiguous());
    transposed.push_back(turned.back().const_data_ptr<T>());
    sums.push_back(at::zeros({w.size(0), padded(w.size(1))}, w.options()));
    grad_weights.push_back(sums.back().data_ptr<T>());
  }
  const Layers<T> network{layers.data(), transposed.data(), layers.size()};
  const Workspace<T> work(layers);
  Passes answer{at::empty_like(grad_out), at::empty_like(x), {}};
  using P = Processor<kVectorBytes>;
  forward_points<P>(x.const_data_ptr<T>(), network, work.buffers, answer.y.data_ptr<T>(), 0, kCount,
                    kCount);
  backward_points<P>(x.const_data_ptr<T>(), network, work.buffers, grad_out.const_data_ptr<T>(),
                     answer.grad_x.data_ptr<T>(), grad_weights.data(), 0, kCount, kCount);
  for (size_t k = 0; k < weights.size(); ++k) {
    answer.grad_weights.push_back(sums[k].narrow(1, 0, weights[k].size(1)));
  }
  return answer;
}

double difference(const Tensor& a, const Tensor& b) {
  return (a.to(at::kDouble) - b.to(at::kDouble)).abs().max().item<double>();
}

template <typename T, int kVectorBytes>
void expect_reference(at::ScalarType type, double tolerance) {
  const std::vector<Tensor> weights = {testing::uniform({21, 35}, -1, 1, 1).to(type),
                                       testing::uniform({70, 21}, -1, 1, 2).to(type),
                                       testing::uniform({6, 70}, -1, 1, 3).to(type)};
  const Tensor x = testing::uniform({35, kCount}, -1, 1, 4).to(type);
  const Tensor grad_out = testing::uniform({6, kCount}, -1, 1, 5).to(type);
  const Passes want = passes_of_tensors(x, weights, grad_out);
  const Passes have = passes_of_kernel<T, kVectorBytes>(x, weights, grad_out);
  EXPECT_LT(difference(have.y, want.y), tolerance) << kVectorBytes;
  EXPECT_LT(difference(have.grad_x, want.grad_x), tolerance) << kVectorBytes;
  for (size_t k = 0; k < weights.size(); ++k) {
    EXPECT_LT(difference(have.grad_weights[k], want.grad_weights[k]), tolerance)
        << kVectorBytes << " layer " << k;
  }
}

TEST(MlpWidths, EveryVectorWidthGivesTheReference) {
  expect_reference<float, 16>(at::kFloat, 1e-2);
  expect_reference<float, 32>(at::kFloat, 1e-2);
  expect_reference<float, 64>(at::kFloat, 1e-2);
  expect_reference<double, 16>(at::kDouble, 1e-10);
  expect_reference<double, 32>(at::kDouble, 1e-10);
  expect_reference<double, 64>(at::kDouble, 1e-10);
}

}  // namespace
}  // namespace tt3d::field
