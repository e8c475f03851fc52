#pragma once

#include <cmath>
#include <cstdint>

#include "tt3d/kernel.h"

/// Bodies of volume rendering: one ray (Max, "Optical models for direct volume rendering", 1995).
namespace tt3d::field {

/// A ray is opaque below this transmittance.
inline constexpr double kOpaque = 1e-4;

/// out[4] = premultiplied colour and alpha of samples [begin,end); colors [3,S].
template <typename T>
TT3D_HD void composite_ray(const T* densities, const T* colors, const T* steps, int64_t begin,
                           int64_t end, int64_t samples, T out[4]) {
  T transmittance = 1;
  for (int c = 0; c < 4; ++c) out[c] = 0;
  for (int64_t i = begin; i < end && transmittance > T(kOpaque); ++i) {
    const T alpha = T(1) - std::exp(-densities[i] * steps[i]);
    const T weight = transmittance * alpha;
    for (int c = 0; c < 3; ++c) out[c] += weight * colors[c * samples + i];
    out[3] += weight;
    transmittance *= T(1) - alpha;
  }
}

/// With C = sum_i T_i a_i c_i: dC/dsigma_i = step_i (T_{i+1} c_i - sum_{j>i} T_j a_j c_j).
template <typename T>
TT3D_HD void composite_ray_backward(const T* densities, const T* colors, const T* steps,
                                    int64_t begin, int64_t end, int64_t samples, const T grad[4],
                                    T* grad_densities, T* grad_colors) {
  T total[4];
  composite_ray(densities, colors, steps, begin, end, samples, total);
  T behind = 0;  // gradient-weighted sum over j > i
  for (int c = 0; c < 4; ++c) behind += grad[c] * total[c];
  T transmittance = 1;
  for (int64_t i = begin; i < end && transmittance > T(kOpaque); ++i) {
    const T alpha = T(1) - std::exp(-densities[i] * steps[i]);
    const T weight = transmittance * alpha;
    T value = grad[3];
    for (int c = 0; c < 3; ++c) {
      value += grad[c] * colors[c * samples + i];
      grad_colors[c * samples + i] = grad[c] * weight;
    }
    behind -= weight * value;
    transmittance *= T(1) - alpha;
    grad_densities[i] = steps[i] * (transmittance * value - behind);
  }
}

template <typename T>
struct CompositeRay {
  const T* densities;
  const T* colors;
  const T* steps;
  const int64_t* ray_begin;
  T* out;
  int64_t samples;
  TT3D_HD void operator()(int64_t r) const {
    composite_ray(densities, colors, steps, ray_begin[r], ray_begin[r + 1], samples, out + 4 * r);
  }
};

template <typename T>
struct CompositeBackwardRay {
  const T* densities;
  const T* colors;
  const T* steps;
  const int64_t* ray_begin;
  const T* grad_out;
  T* grad_densities;
  T* grad_colors;
  int64_t samples;
  TT3D_HD void operator()(int64_t r) const {
    composite_ray_backward(densities, colors, steps, ray_begin[r], ray_begin[r + 1], samples,
                           grad_out + 4 * r, grad_densities, grad_colors);
  }
};

}  // namespace tt3d::field
