#pragma once

#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>
#include <gtest/gtest.h>
#include <torch/csrc/autograd/autograd.h>

#include <functional>
#include <string>
#include <vector>

namespace tt3d::testing {

/// Scalar function of float64 tensors.
using ScalarFunction = std::function<at::Tensor(const std::vector<at::Tensor>&)>;

/// Worst relative difference between autograd and central differences over `inputs`, element by
/// element, relative to the largest gradient of that input (plus 1e-8).
inline double gradient_error(const ScalarFunction& function, std::vector<at::Tensor> inputs,
                             double step = 1e-6) {
  for (at::Tensor& t : inputs) t = t.detach().to(at::kDouble).contiguous().requires_grad_(true);
  const auto grads = torch::autograd::grad({function(inputs)}, inputs);
  double worst = 0;
  at::NoGradGuard guard;
  for (size_t i = 0; i < inputs.size(); ++i) {
    at::Tensor numeric = at::zeros_like(inputs[i]);
    auto* value = inputs[i].mutable_data_ptr<double>();
    auto* out = numeric.mutable_data_ptr<double>();
    for (int64_t k = 0; k < inputs[i].numel(); ++k) {
      const double saved = value[k];
      value[k] = saved + step;
      const double high = function(inputs).item<double>();
      value[k] = saved - step;
      const double low = function(inputs).item<double>();
      value[k] = saved;
      out[k] = (high - low) / (2 * step);
    }
    const double scale = numeric.abs().max().item<double>() + 1e-8;
    worst = std::max(worst, (grads[i] - numeric).abs().max().item<double>() / scale);
  }
  return worst;
}

/// Cosine between two tensors as vectors. It checks the direction, which an element-wise bound does
/// not.
inline double cosine(const at::Tensor& a, const at::Tensor& b) {
  const at::Tensor x = a.flatten().to(at::kDouble), y = b.flatten().to(at::kDouble);
  return (x.dot(y) / (x.norm() * y.norm() + 1e-30)).item<double>();
}

}  // namespace tt3d::testing
