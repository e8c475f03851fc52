#pragma once

#include <cmath>
#include <cstdint>

#include "tt3d/kernel.h"

/// Body of Adam: one parameter.
namespace tt3d::field {

struct AdamEntry {
  float* parameter;
  const float* gradient;
  float *moment1, *moment2;
  float beta1, beta2, epsilon, rate;  ///< epsilon and rate with the bias correction in them
  TT3D_HD void operator()(int64_t i) const {
    const float g = gradient[i];
    if (g == 0.0F) return;
    const float m = beta1 * moment1[i] + (1 - beta1) * g;
    const float v = beta2 * moment2[i] + (1 - beta2) * g * g;
    moment1[i] = m;
    moment2[i] = v;
    parameter[i] -= rate * m / (std::sqrt(v) + epsilon);
  }
};

}  // namespace tt3d::field
