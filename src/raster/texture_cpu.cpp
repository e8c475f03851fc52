#include "pixels_cpu.h"
#include "raster_kernels.h"

namespace tt3d::raster {

/// Scatters into texels run on one thread, in pixel order; uv gradients ride along.
template <typename T>
void scatter(const Cpu&, const TextureBackwardPixel<T>& body) {
  with_channels(body.s.channels, [&](auto channels) {
    for (int64_t i = 0; i < body.s.pixels(); ++i) body.spread(i, channels);
  });
}

template <typename T>
void for_each_pixel(const Cpu&, const TexturePixel<T>& body) {
  with_channels(body.s.channels, [&](auto channels) {
    for_each_index(body.s.pixels(), [&](int64_t i) { body.write(i, channels); });
  });
}

template void for_each_pixel(const Cpu&, const TexturePixel<float>&);
template void for_each_pixel(const Cpu&, const TexturePixel<double>&);
template void scatter(const Cpu&, const TextureBackwardPixel<float>&);
template void scatter(const Cpu&, const TextureBackwardPixel<double>&);

}  // namespace tt3d::raster
