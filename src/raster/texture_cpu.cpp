#include "raster_kernels.h"
#include "tt3d/device.h"

namespace tt3d::raster {

template <typename T>
void texture(const Cpu&, const TexturePixel<T>& body) {
  for_each_index(body.s.pixels(), body);
}

/// Scatters into texels run on one thread, in pixel order; uv gradients ride along.
template <typename T>
void texture_backward(const Cpu&, const TextureBackwardPixel<T>& body) {
  for (int64_t i = 0; i < body.s.pixels(); ++i) body(i);
}

#define TT3D_INSTANTIATE(T)                                  \
  template void texture(const Cpu&, const TexturePixel<T>&); \
  template void texture_backward(const Cpu&, const TextureBackwardPixel<T>&);
TT3D_INSTANTIATE(float)
TT3D_INSTANTIATE(double)
#undef TT3D_INSTANTIATE

}  // namespace tt3d::raster
