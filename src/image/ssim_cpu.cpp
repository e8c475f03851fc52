#include "ssim_cpu.h"

#include <cmath>
#include <vector>

#include "ssim_math.h"
#include "tt3d/device.h"

namespace tt3d::image::similarity {

int64_t Sizes::window_rows() const { return (height - kTaps) / stride + 1; }
int64_t Sizes::window_columns() const { return (width - kTaps) / stride + 1; }

namespace {

template <typename T>
struct Window {
  Window() {
    double total = 0, weights[kTaps];
    for (int k = 0; k < kTaps; ++k) {
      const double offset = k - kTaps / 2;
      total += weights[k] = std::exp(-offset * offset / (2 * kSigma * kSigma));
    }
    for (int k = 0; k < kTaps; ++k) tap[k] = static_cast<T>(weights[k] / total);
  }
  T tap[kTaps];
};

/// Weighted sums of the five moments over kTaps rows: columns [kMoments,width].
template <typename T>
TT3D_HD void sum_columns(const T* __restrict x, const T* __restrict y, const T* tap, int64_t width,
                         T* __restrict columns) {
  for (int64_t i = 0; i < kMoments * width; ++i) columns[i] = 0;
  for (int k = 0; k < kTaps; ++k) {
    const T w = tap[k];
    const T *xk = x + k * width, *yk = y + k * width;
    for (int64_t i = 0; i < width; ++i) {
      const T a = xk[i], b = yk[i], wa = w * a, wb = w * b;
      columns[kX * width + i] += wa;
      columns[kY * width + i] += wb;
      columns[kXX * width + i] += wa * a;
      columns[kYY * width + i] += wb * b;
      columns[kXY * width + i] += wa * b;
    }
  }
}

/// Sums `columns` along the row: the windows' moments [kMoments,count].
template <typename T>
TT3D_HD void sum_rows(const T* __restrict columns, const T* tap, int64_t width, int64_t stride,
                      int64_t count, T* __restrict moments) {
  for (int m = 0; m < kMoments; ++m) {
    const T* from = columns + m * width;
    T* to = moments + m * count;
    for (int64_t i = 0; i < count; ++i) to[i] = 0;
    for (int k = 0; k < kTaps; ++k) {
      for (int64_t i = 0; i < count; ++i) to[i] += tap[k] * from[i * stride + k];
    }
  }
}

/// Sum of the windows' similarities; writes slopes [3,count] if wanted.
template <typename T>
TT3D_HD T sum_similarities(const T* __restrict moments, int64_t count, T* __restrict slopes) {
  T total = 0;
  for (int64_t i = 0; i < count; ++i) {
    T m[kMoments], slope[3];
    for (int k = 0; k < kMoments; ++k) m[k] = moments[k * count + i];
    total += similarity(m, slopes ? slope : nullptr);
    for (int k = 0; slopes && k < 3; ++k) slopes[k * count + i] = slope[k];
  }
  return total;
}

/// One row of windows; scratch holds kMoments * (width + count) numbers.
template <typename T>
TT3D_HD T window_row(const T* x, const T* y, const T* tap, int64_t width, int64_t stride,
                     int64_t count, T* scratch, T* slopes) {
  T* moments = scratch + kMoments * width;
  sum_columns(x, y, tap, width, scratch);
  if (stride == 1)
    sum_rows(scratch, tap, width, 1, count, moments);
  else if (stride == 2)
    sum_rows(scratch, tap, width, 2, count, moments);
  else
    sum_rows(scratch, tap, width, stride, count, moments);
  return sum_similarities(moments, count, slopes);
}

/// Adds the gradient of one row of windows to the kTaps rows that it covers. scratch [3,width].
template <typename T>
TT3D_HD void spread_row(const T* __restrict x, const T* __restrict y, const T* tap, int64_t width,
                        int64_t stride, int64_t count, const T* __restrict slopes, T scale,
                        T* __restrict scratch, T* __restrict grad) {
  for (int64_t i = 0; i < 3 * width; ++i) scratch[i] = 0;
  for (int m = 0; m < 3; ++m) {
    for (int k = 0; k < kTaps; ++k) {
      const T w = tap[k] * scale;
      T* to = scratch + m * width + k;
      for (int64_t i = 0; i < count; ++i) to[i * stride] += w * slopes[m * count + i];
    }
  }
  const T *of_x = scratch, *of_xx = scratch + width, *of_xy = scratch + 2 * width;
  for (int k = 0; k < kTaps; ++k) {
    const T *xk = x + k * width, *yk = y + k * width;
    T* gk = grad + k * width;
    for (int64_t i = 0; i < width; ++i) {
      gk[i] += tap[k] * (of_x[i] + 2 * of_xx[i] * xk[i] + of_xy[i] * yk[i]);
    }
  }
}

// Macros, because target_clones does not apply to templates.
#define TT3D_SSIM_LOOPS(T)                                                                 \
  TT3D_CPU_LOOP T similarity_row(const T* x, const T* y, const T* tap, int64_t width,      \
                                 int64_t stride, int64_t count, T* scratch, T* slopes) {   \
    return window_row(x, y, tap, width, stride, count, scratch, slopes);                   \
  }                                                                                        \
  TT3D_CPU_LOOP void gradient_row(const T* x, const T* y, const T* tap, int64_t width,     \
                                  int64_t stride, int64_t count, const T* slopes, T scale, \
                                  T* scratch, T* grad) {                                   \
    spread_row(x, y, tap, width, stride, count, slopes, scale, scratch, grad);             \
  }
TT3D_SSIM_LOOPS(float)
TT3D_SSIM_LOOPS(double)
#undef TT3D_SSIM_LOOPS

}  // namespace

template <typename T>
void mean_cpu(const T* x, const T* y, T* mean, T* slopes, const Sizes& s) {
  const Window<T> window;
  const int64_t rows = s.window_rows(), count = s.window_columns(), plane = s.height * s.width;
  const auto make = [&] { return std::vector<T>(kMoments * (s.width + count)); };
  for_each_task(s.planes, make, [&](int64_t p, std::vector<T>& scratch) {
    T total = 0;
    for (int64_t r = 0; r < rows; ++r) {
      const int64_t from = p * plane + r * s.stride * s.width;
      T* slope = slopes ? slopes + (p * rows + r) * 3 * count : nullptr;
      total += similarity_row(x + from, y + from, window.tap, s.width, s.stride, count,
                              scratch.data(), slope);
    }
    mean[p] = total / static_cast<T>(rows * count);
  });
}

template <typename T>
void gradient_cpu(const T* x, const T* y, const T* slopes, const T* grad_mean, T* grad_x,
                  const Sizes& s) {
  const Window<T> window;
  const int64_t rows = s.window_rows(), count = s.window_columns(), plane = s.height * s.width;
  const auto make = [&] { return std::vector<T>(3 * s.width); };
  for_each_task(s.planes, make, [&](int64_t p, std::vector<T>& scratch) {
    std::fill_n(grad_x + p * plane, plane, T(0));
    const T scale = grad_mean[p] / static_cast<T>(rows * count);
    for (int64_t r = 0; r < rows; ++r) {
      const int64_t from = p * plane + r * s.stride * s.width;
      gradient_row(x + from, y + from, window.tap, s.width, s.stride, count,
                   slopes + (p * rows + r) * 3 * count, scale, scratch.data(), grad_x + from);
    }
  });
}

#define TT3D_INSTANTIATE(T)                                         \
  template void mean_cpu(const T*, const T*, T*, T*, const Sizes&); \
  template void gradient_cpu(const T*, const T*, const T*, const T*, T*, const Sizes&);
TT3D_INSTANTIATE(float)
TT3D_INSTANTIATE(double)
#undef TT3D_INSTANTIATE

}  // namespace tt3d::image::similarity
