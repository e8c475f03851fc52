#pragma once

#include <ATen/core/Tensor.h>

#include <vector>

namespace tt3d::field {

/// Throws c10::Error unless x is [I,P] on the weights' device, I being the first layer's inputs.
void check_mlp(const char* name, const at::Tensor& x, const std::vector<at::Tensor>& weights);

/// Whether half_mlp supports the network: float32, and small enough for a team's memory.
[[nodiscard]] bool half_mlp_fits(const std::vector<at::Tensor>& weights);

}  // namespace tt3d::field
