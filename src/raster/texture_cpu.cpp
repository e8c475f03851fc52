#include "raster_kernels.h"

namespace tt3d::raster {

/// Scatters into texels run on one thread, in pixel order; uv gradients ride along.
template <typename T>
void scatter(const Cpu&, const TextureBackwardPixel<T>& body) {
  for (int64_t i = 0; i < body.s.pixels(); ++i) body(i);
}

template void scatter(const Cpu&, const TextureBackwardPixel<float>&);
template void scatter(const Cpu&, const TextureBackwardPixel<double>&);

}  // namespace tt3d::raster
