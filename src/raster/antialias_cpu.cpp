#include "antialias_math.h"
#include "raster_cpu.h"

namespace tt3d::raster {
namespace {

/// One view's part of the tensors.
template <typename T>
struct ViewSlice {
  const T* rast;
  const T* clip;
  const int32_t* faces;
  const int32_t* opposites;
};

/// Calls visit(pixel_a, pixel_b, ax, ay, bx, by, crossing) for every pair of neighbouring pixels
/// of one view that a silhouette edge separates.
template <typename T, typename Visit>
void for_each_crossing(const ViewSlice<T>& view, const Sizes& s, const Visit& visit) {
  const auto try_pair = [&](int64_t x, int64_t y, bool horizontal) {
    const int64_t a = y * s.width + x;
    const int64_t b = horizontal ? a + 1 : a + s.width;
    if (view.rast[4 * a + 3] == view.rast[4 * b + 3]) return;
    const double ax = pixel_x(x, s.width), ay = pixel_y(y, s.height);
    const double bx = horizontal ? pixel_x(x + 1, s.width) : ax;
    const double by = horizontal ? ay : pixel_y(y + 1, s.height);
    EdgeCrossing crossing;
    if (find_crossing(view.clip, view.faces, view.opposites, view.rast + 4 * a, view.rast + 4 * b,
                      ax, ay, bx, by, horizontal, crossing)) {
      visit(a, b, ax, ay, bx, by, crossing);
    }
  };
  for (int64_t y = 0; y < s.height; ++y) {
    for (int64_t x = 0; x < s.width; ++x) {
      if (x + 1 < s.width) try_pair(x, y, true);
      if (y + 1 < s.height) try_pair(x, y, false);
    }
  }
}

}  // namespace

template <typename T>
void antialias_cpu(const T* color, const T* rast, const T* clip, const int32_t* faces,
                   const int32_t* opposites, T* out, const Sizes& s) {
  const int64_t pixels = s.height * s.width;
  at::parallel_for(0, s.views, 1, [&](int64_t first, int64_t last) {
    for (int64_t n = first; n < last; ++n) {
      const ViewSlice<T> view = {rast + n * pixels * 4, clip + n * s.vertices * 4, faces,
                                 opposites};
      const T* source = color + n * pixels * s.channels;
      T* target = out + n * pixels * s.channels;
      for_each_crossing(
          view, s,
          [&](int64_t a, int64_t b, double, double, double, double, const EdgeCrossing& crossing) {
            const Blend blend = blend_of(crossing);
            const int64_t into = blend.into_a ? a : b;
            const int64_t from = blend.into_a ? b : a;
            for (int64_t c = 0; c < s.channels; ++c) {
              target[into * s.channels + c] +=
                  static_cast<T>(blend.weight) *
                  (source[from * s.channels + c] - source[into * s.channels + c]);
            }
          });
    }
  });
}

template <typename T>
void antialias_backward_cpu(const T* color, const T* rast, const T* clip, const int32_t* faces,
                            const int32_t* opposites, const T* grad_out, T* grad_color,
                            T* grad_clip, const Sizes& s) {
  const int64_t pixels = s.height * s.width;
  at::parallel_for(0, s.views, 1, [&](int64_t first, int64_t last) {
    for (int64_t n = first; n < last; ++n) {
      const ViewSlice<T> view = {rast + n * pixels * 4, clip + n * s.vertices * 4, faces,
                                 opposites};
      const T* source = color + n * pixels * s.channels;
      const T* grad = grad_out + n * pixels * s.channels;
      T* target = grad_color + n * pixels * s.channels;
      for_each_crossing(view, s,
                        [&](int64_t a, int64_t b, double ax, double ay, double bx, double by,
                            const EdgeCrossing& crossing) {
                          const Blend blend = blend_of(crossing);
                          const int64_t into = (blend.into_a ? a : b) * s.channels;
                          const int64_t from = (blend.into_a ? b : a) * s.channels;
                          double grad_weight = 0;
                          for (int64_t c = 0; c < s.channels; ++c) {
                            const T g = grad[into + c];
                            target[from + c] += static_cast<T>(blend.weight) * g;
                            target[into + c] -= static_cast<T>(blend.weight) * g;
                            grad_weight +=
                                static_cast<double>(g * (source[from + c] - source[into + c]));
                          }
                          if (!grad_clip) return;
                          double grad0[4] = {}, grad1[4] = {};
                          crossing_backward(view.clip, crossing, ax, ay, bx, by,
                                            grad_weight * blend.slope, grad0, grad1);
                          T* clip0 = grad_clip + (n * s.vertices + crossing.v0) * 4;
                          T* clip1 = grad_clip + (n * s.vertices + crossing.v1) * 4;
                          for (int k = 0; k < 4; ++k) {
                            clip0[k] += static_cast<T>(grad0[k]);
                            clip1[k] += static_cast<T>(grad1[k]);
                          }
                        });
    }
  });
}

#define TT3D_INSTANTIATE(T)                                                                     \
  template void antialias_cpu(const T*, const T*, const T*, const int32_t*, const int32_t*, T*, \
                              const Sizes&);                                                    \
  template void antialias_backward_cpu(const T*, const T*, const T*, const int32_t*,            \
                                       const int32_t*, const T*, T*, T*, const Sizes&);
TT3D_INSTANTIATE(float)
TT3D_INSTANTIATE(double)
#undef TT3D_INSTANTIATE

}  // namespace tt3d::raster
