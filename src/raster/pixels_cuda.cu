#include "raster_kernels.h"
#include "tt3d/cuda.h"

// The GPU's executors of the bodies that are a pixel each: a thread a pixel.
namespace tt3d::raster {

template <typename T>
void rasterize_backward(const Cuda& on, const RasterizeBackwardPixel<T>& body) {
  for_each_index(on, body.s.pixels(), body);
}

template <typename T>
void interpolate(const Cuda& on, const InterpolatePixel<T>& body) {
  for_each_index(on, body.s.pixels(), body);
}

template <typename T>
void interpolate_backward(const Cuda& on, const InterpolateBackwardRast<T>& body) {
  for_each_index(on, body.s.pixels(), body);
}

template <typename T>
void interpolate_backward(const Cuda& on, const InterpolateBackwardAttributes<T>& body) {
  for_each_index(on, body.s.pixels(), body);
}

template <typename T>
void attribute_derivatives(const Cuda& on, const AttributeDerivativesPixel<T>& body) {
  for_each_index(on, body.s.pixels(), body);
}

template <typename T>
void antialias(const Cuda& on, const AntialiasPixel<T>& body) {
  for_each_index(on, body.scene.s.pixels(), body);
}

template <typename T>
void antialias_backward(const Cuda& on, const AntialiasBackwardPixel<T>& body) {
  for_each_index(on, body.scene.s.pixels(), body);
}

template <typename T>
void texture(const Cuda& on, const TexturePixel<T>& body) {
  for_each_index(on, body.s.pixels(), body);
}

template <typename T>
void texture_backward(const Cuda& on, const TextureBackwardPixel<T>& body) {
  for_each_index(on, body.s.pixels(), body);
}

#define TT3D_INSTANTIATE(T)                                                                 \
  template void rasterize_backward(const Cuda&, const RasterizeBackwardPixel<T>&);          \
  template void interpolate(const Cuda&, const InterpolatePixel<T>&);                       \
  template void interpolate_backward(const Cuda&, const InterpolateBackwardRast<T>&);       \
  template void interpolate_backward(const Cuda&, const InterpolateBackwardAttributes<T>&); \
  template void attribute_derivatives(const Cuda&, const AttributeDerivativesPixel<T>&);    \
  template void antialias(const Cuda&, const AntialiasPixel<T>&);                           \
  template void antialias_backward(const Cuda&, const AntialiasBackwardPixel<T>&);          \
  template void texture(const Cuda&, const TexturePixel<T>&);                               \
  template void texture_backward(const Cuda&, const TextureBackwardPixel<T>&);
TT3D_INSTANTIATE(float)
TT3D_INSTANTIATE(double)
#undef TT3D_INSTANTIATE

}  // namespace tt3d::raster
