#pragma once

#include <cmath>
#include <cstdint>

#include "tt3d/kernel.h"

/// Kernel body of Adam (Kingma and Ba 2015): one parameter. If the gradient is zero, parameter and
/// moments stay unchanged, because a step reaches only few entries of a hash grid.
namespace tt3d::optimize {

struct AdamEntry {
  float* parameter;
  const float* gradient;
  float *moment1, *moment2;
  float beta1, beta2, epsilon, rate;  ///< epsilon and rate include the bias correction
  TT3D_HD void operator()(int64_t i) const {
    const float g = gradient[i];
    const bool moves = g != 0.0F;
    const float m = beta1 * moment1[i] + (1 - beta1) * g;
    const float v = beta2 * moment2[i] + (1 - beta2) * g * g;
    moment1[i] = moves ? m : moment1[i];
    moment2[i] = moves ? v : moment2[i];
    parameter[i] -= moves ? rate * m / (std::sqrt(v) + epsilon) : 0.0F;
  }
};

}  // namespace tt3d::optimize
