#pragma once

#include <ATen/core/Tensor.h>

#include <vector>

namespace tt3d::field {

/// Throws c10::Error unless x is [I,P], I the first layer's inputs, on the weights' device.
void check_mlp(const char* name, const at::Tensor& x, const std::vector<at::Tensor>& weights);

/// Whether half_mlp takes the network: float32, and small enough for a team's memory.
[[nodiscard]] bool half_mlp_fits(const std::vector<at::Tensor>& weights);

}  // namespace tt3d::field
