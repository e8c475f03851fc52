#include "blur_cpu.h"

#include <algorithm>
#include <vector>

#include "tt3d/device.h"

namespace tt3d::image {
namespace {

/// to[0,n) += weight * from[0,n).
template <typename T>
TT3D_HD void add_scaled(T weight, const T* __restrict from, T* __restrict to, int64_t n) {
  for (int64_t i = 0; i < n; ++i) to[i] += weight * from[i];
}

TT3D_HD int64_t clamped(int64_t i, int64_t n) { return i < 0 ? 0 : (i >= n ? n - 1 : i); }

/// scratch [2 * radius + width]: a row blurred along the columns, with its ends repeated.
template <typename T>
TT3D_HD void blur_plane(const BlurInput<T>& b, const T* in, T* scratch, T* out) {
  const int64_t r = b.radius, width = b.width;
  for (int64_t y = 0; y < b.height; ++y) {
    T *row = scratch + r, *to = out + y * width;
    for (int64_t x = 0; x < width; ++x) row[x] = to[x] = 0;
    for (int64_t k = -r; k <= r; ++k) {
      add_scaled(b.tap[k < 0 ? -k : k], in + clamped(y + k, b.height) * width, row, width);
    }
    for (int64_t k = 1; k <= r; ++k) {
      row[-k] = row[0];
      row[width - 1 + k] = row[width - 1];
    }
    for (int64_t k = -r; k <= r; ++k) add_scaled(b.tap[k < 0 ? -k : k], row + k, to, width);
  }
}

template <typename T>
TT3D_HD void blur_plane_backward(const BlurInput<T>& b, const T* grad, T* scratch, T* out) {
  const int64_t r = b.radius, width = b.width;
  for (int64_t i = 0; i < b.height * width; ++i) out[i] = 0;
  for (int64_t y = 0; y < b.height; ++y) {
    T* row = scratch + r;
    for (int64_t x = -r; x < width + r; ++x) row[x] = 0;
    for (int64_t k = -r; k <= r; ++k) {
      add_scaled(b.tap[k < 0 ? -k : k], grad + y * width, row + k, width);
    }
    for (int64_t k = 1; k <= r; ++k) {
      row[0] += row[-k];
      row[width - 1] += row[width - 1 + k];
    }
    for (int64_t k = -r; k <= r; ++k) {
      add_scaled(b.tap[k < 0 ? -k : k], row, out + clamped(y + k, b.height) * width, width);
    }
  }
}

// Macros, because target_clones does not apply to templates.
#define TT3D_BLUR_LOOPS(T)                                                                      \
  TT3D_CPU_LOOP void plane(const BlurInput<T>& b, const T* in, T* scratch, T* out) {            \
    blur_plane(b, in, scratch, out);                                                            \
  }                                                                                             \
  TT3D_CPU_LOOP void plane_backward(const BlurInput<T>& b, const T* grad, T* scratch, T* out) { \
    blur_plane_backward(b, grad, scratch, out);                                                 \
  }
TT3D_BLUR_LOOPS(float)
TT3D_BLUR_LOOPS(double)
#undef TT3D_BLUR_LOOPS

template <typename T, typename Plane>
void for_each_plane(const BlurInput<T>& b, T* out, const Plane& body) {
  const int64_t pixels = b.height * b.width;
  const auto make = [&] { return std::vector<T>(b.width + 2 * b.radius); };
  for_each_task(b.planes, make, [&](int64_t p, std::vector<T>& scratch) {
    body(b, b.in + p * pixels, scratch.data(), out + p * pixels);
  });
}

}  // namespace

template <typename T>
void blur_cpu(const BlurInput<T>& input, T* out) {
  for_each_plane(input, out, [](const auto&... arguments) { plane(arguments...); });
}

template <typename T>
void blur_backward_cpu(const BlurInput<T>& grad_out, T* grad_in) {
  for_each_plane(grad_out, grad_in, [](const auto&... arguments) { plane_backward(arguments...); });
}

template void blur_cpu(const BlurInput<float>&, float*);
template void blur_cpu(const BlurInput<double>&, double*);
template void blur_backward_cpu(const BlurInput<float>&, float*);
template void blur_backward_cpu(const BlurInput<double>&, double*);

}  // namespace tt3d::image
