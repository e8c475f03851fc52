#include "pixels_cpu.h"
#include "raster_kernels.h"

namespace tt3d::raster {
namespace {

/// Rows [first,last) of the coarser of two adjacent levels.
template <typename Body>
TT3D_HD void texel_rows(const Body& body, int64_t first, int64_t last) {
  with_channels(body.channels, [&](auto channels) TT3D_INLINE {
    const int64_t width = body.fine.width / 2;
    for (int64_t row = first; row < last; ++row) {
      for (int64_t column = 0; column < width; ++column) body.texel(row, column, channels);
    }
  });
}

// Macros, because target_clones does not apply to templates.
#define TT3D_TEXTURE_LOOPS(T)                                                               \
  TT3D_CPU_LOOP void write_loop(const TexturePixel<T>& body, int64_t first, int64_t last) { \
    with_channels(body.s.channels, [&](auto channels) TT3D_INLINE {                         \
      for (int64_t i = first; i < last; ++i) body.write(i, channels);                       \
    });                                                                                     \
  }                                                                                         \
  TT3D_CPU_LOOP void spread_loop(const TextureBackwardPixel<T>& body, int64_t count) {      \
    with_channels(body.s.channels, [&](auto channels) TT3D_INLINE {                         \
      for (int64_t i = 0; i < count; ++i) body.spread(i, channels);                         \
    });                                                                                     \
  }                                                                                         \
  TT3D_CPU_LOOP void texel_loop(const HalveTexel<T>& body, int64_t first, int64_t last) {   \
    texel_rows(body, first, last);                                                          \
  }                                                                                         \
  TT3D_CPU_LOOP void texel_loop(const FoldTexel<T>& body, int64_t first, int64_t last) {    \
    texel_rows(body, first, last);                                                          \
  }
TT3D_TEXTURE_LOOPS(float)
TT3D_TEXTURE_LOOPS(double)
#undef TT3D_TEXTURE_LOOPS

template <typename Body>
void each_row_of_texels(const Body& body) {
  const int64_t rows = body.fine.height / 2;
  const int64_t least = std::max<int64_t>(1, kPixelsATask / std::max<int64_t>(1, body.fine.width));
  at::parallel_for(0, rows, least,
                   [&](int64_t first, int64_t last) { texel_loop(body, first, last); });
}

}  // namespace

/// Runs on one thread, in pixel order, because pixels share texels; computes the uv gradients too.
template <typename T>
void scatter(const Cpu&, const TextureBackwardPixel<T>& body) {
  spread_loop(body, body.s.pixels());
}

template <typename T>
void for_each_pixel(const Cpu&, const TexturePixel<T>& body) {
  at::parallel_for(0, body.s.pixels(), kPixelsATask,
                   [&](int64_t first, int64_t last) { write_loop(body, first, last); });
}

template <typename T>
void for_each_texel(const Cpu&, const HalveTexel<T>& body) {
  each_row_of_texels(body);
}

template <typename T>
void for_each_texel(const Cpu&, const FoldTexel<T>& body) {
  each_row_of_texels(body);
}

#define TT3D_INSTANTIATE(T)                                         \
  template void for_each_pixel(const Cpu&, const TexturePixel<T>&); \
  template void for_each_texel(const Cpu&, const HalveTexel<T>&);   \
  template void for_each_texel(const Cpu&, const FoldTexel<T>&);    \
  template void scatter(const Cpu&, const TextureBackwardPixel<T>&);
TT3D_INSTANTIATE(float)
TT3D_INSTANTIATE(double)
#undef TT3D_INSTANTIATE

}  // namespace tt3d::raster
