#pragma once

#include <cstdint>

#include "tt3d/kernel.h"

/// Bodies of to_clip.
namespace tt3d::scene {

/// Body: vertex i % vertices in view i / vertices: clip = matrix (x, y, z, 1).
template <typename T>
struct ProjectVertex {
  const T* points;    ///< [V,3]
  const T* matrices;  ///< [N,4,4]
  T* clip;            ///< [N,V,4]
  int64_t vertices;
  TT3D_HD void operator()(int64_t i) const {
    const int64_t view = i / vertices;
    const T* p = points + 3 * (i - view * vertices);
    const T* row = matrices + 16 * view;
    for (int k = 0; k < 4; ++k, row += 4) {
      clip[4 * i + k] = row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + row[3];
    }
  }
};

/// Body: the gradient of vertex v, summed over the views in order; overwrites it.
template <typename T>
struct ProjectBackwardVertex {
  const T* grad_clip;  ///< [N,V,4]
  const T* matrices;
  T* grad_points;  ///< [V,3]
  int64_t views, vertices;
  TT3D_HD void operator()(int64_t v) const {
    T sum[3] = {T(0), T(0), T(0)};
    for (int64_t n = 0; n < views; ++n) {
      const T* grad = grad_clip + 4 * (n * vertices + v);
      const T* row = matrices + 16 * n;
      for (int k = 0; k < 4; ++k, row += 4) {
        for (int c = 0; c < 3; ++c) sum[c] += grad[k] * row[c];
      }
    }
    for (int c = 0; c < 3; ++c) grad_points[3 * v + c] = sum[c];
  }
};

}  // namespace tt3d::scene
