#include "pixels_cpu.h"
#include "raster_kernels.h"

namespace tt3d::raster {
template <typename T>
void for_each_pixel(const Cpu&, const InterpolatePixel<T>& body) {
  with_channels(body.s.channels, [&](auto channels) {
    for_each_index(body.s.pixels(), [&](int64_t i) { body.write(i, channels); });
  });
}

template <typename T>
void scatter(const Cpu&, const InterpolateBackwardPixel<T>& body) {
  with_channels(body.s.channels, [&](auto channels) {
    if (!body.grad_attributes) {
      for_each_index(body.s.pixels(), [&](int64_t i) { body.spread(i, channels, nullptr); });
      return;
    }
    const auto add = [&](int64_t /*group*/, int64_t first, int64_t last, T* sums) {
      for (int64_t i = first; i < last; ++i) body.spread(i, channels, sums);
    };
    scatter_in_parts(1, body.s.pixels(), body.s.vertices, channels, body.grad_attributes, add);
  });
}

#define TT3D_INSTANTIATE(T)                                             \
  template void for_each_pixel(const Cpu&, const InterpolatePixel<T>&); \
  template void scatter(const Cpu&, const InterpolateBackwardPixel<T>&);
TT3D_INSTANTIATE(float)
TT3D_INSTANTIATE(double)
#undef TT3D_INSTANTIATE

}  // namespace tt3d::raster
