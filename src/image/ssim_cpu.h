#pragma once

#include <cstdint>

/// Structural similarity of planes on the CPU, row by row: each window is summed along the columns
/// first, then along the row.
namespace tt3d::image::similarity {

struct Sizes {
  int64_t planes, height, width, stride;
  [[nodiscard]] int64_t window_rows() const;
  [[nodiscard]] int64_t window_columns() const;
};

/// Mean over the windows of each plane: x, y [planes,height,width], mean [planes]. `slopes`
/// [planes,window_rows,3,window_columns], if not null, receives the windows' derivatives for
/// gradient_cpu.
template <typename T>
void mean_cpu(const T* x, const T* y, T* mean, T* slopes, const Sizes& s);

/// Gradient with respect to x of sum_p grad_mean[p] mean[p]; grad_mean [planes]. Overwrites grad_x
/// [planes,height,width].
template <typename T>
void gradient_cpu(const T* x, const T* y, const T* slopes, const T* grad_mean, T* grad_x,
                  const Sizes& s);

}  // namespace tt3d::image::similarity
