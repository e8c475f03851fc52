#include "pixels_cpu.h"
#include "raster_kernels.h"

namespace tt3d::raster {
namespace {

/// Rows [first,last) of all views. Neighbouring pixels mostly show the same triangle.
template <typename T, typename Channels>
TT3D_HD void derive_rows(const AttributeDerivativesPixel<T>& body, int64_t first, int64_t last,
                         const Channels& channels) {
  const Sizes& s = body.s;
  const PixelSteps step(s);
  for (int64_t line = first; line < last; ++line) {
    const T* clip = body.clip + line / s.height * s.vertices * 4;
    const double py = pixel_y(line % s.height, s.height);
    BarycentricSlopes slopes = {};
    int64_t shown = -1;
    for (int64_t x = 0; x < s.width; ++x) {
      const int64_t i = line * s.width + x, face = body.face_at(i);
      if (face >= 0 && face != shown) slopes = barycentric_slopes(clip, body.faces + 3 * face);
      if (face >= 0) shown = face;
      body.write(i, face, slopes, pixel_x(x, s.width), py, step, channels);
    }
  }
}

// target_clones needs plain functions.
#define TT3D_INTERPOLATE_LOOPS(T)                                                                \
  TT3D_CPU_LOOP void write_loop(const InterpolatePixel<T>& body, int64_t first, int64_t last) {  \
    with_channels(body.s.channels, [&](auto channels) TT3D_INLINE {                              \
      for (int64_t i = first; i < last; ++i) body.write(i, channels);                            \
    });                                                                                          \
  }                                                                                              \
  TT3D_CPU_LOOP void spread_loop(const InterpolateBackwardPixel<T>& body, int64_t first,         \
                                 int64_t last, T* sums) {                                        \
    with_channels(body.s.channels, [&](auto channels) TT3D_INLINE {                              \
      for (int64_t i = first; i < last; ++i) body.spread(i, channels, sums);                     \
    });                                                                                          \
  }                                                                                              \
  TT3D_CPU_LOOP void derive_loop(const AttributeDerivativesPixel<T>& body, int64_t first,        \
                                 int64_t last) {                                                 \
    with_channels(body.s.channels,                                                               \
                  [&](auto channels) TT3D_INLINE { derive_rows(body, first, last, channels); }); \
  }
TT3D_INTERPOLATE_LOOPS(float)
TT3D_INTERPOLATE_LOOPS(double)
#undef TT3D_INTERPOLATE_LOOPS

}  // namespace

template <typename T>
void for_each_pixel(const Cpu&, const InterpolatePixel<T>& body) {
  at::parallel_for(0, body.s.pixels(), kPixelsATask,
                   [&](int64_t first, int64_t last) { write_loop(body, first, last); });
}

template <typename T>
void for_each_pixel(const Cpu&, const AttributeDerivativesPixel<T>& body) {
  at::parallel_for(0, body.s.views * body.s.height, 1,
                   [&](int64_t first, int64_t last) { derive_loop(body, first, last); });
}

template <typename T>
void scatter(const Cpu&, const InterpolateBackwardPixel<T>& body) {
  if (!body.grad_attributes) {
    at::parallel_for(0, body.s.pixels(), kPixelsATask,
                     [&](int64_t first, int64_t last) { spread_loop(body, first, last, nullptr); });
    return;
  }
  const auto add = [&](int64_t /*group*/, int64_t first, int64_t last, T* sums) {
    spread_loop(body, first, last, sums);
  };
  scatter_in_parts(1, body.s.pixels(), body.s.vertices, body.s.channels, body.grad_attributes, add);
}

#define TT3D_INSTANTIATE(T)                                                      \
  template void for_each_pixel(const Cpu&, const InterpolatePixel<T>&);          \
  template void for_each_pixel(const Cpu&, const AttributeDerivativesPixel<T>&); \
  template void scatter(const Cpu&, const InterpolateBackwardPixel<T>&);
TT3D_INSTANTIATE(float)
TT3D_INSTANTIATE(double)
#undef TT3D_INSTANTIATE

}  // namespace tt3d::raster
