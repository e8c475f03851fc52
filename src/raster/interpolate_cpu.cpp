#include "raster_kernels.h"
#include "tt3d/device.h"

namespace tt3d::raster {

template <typename T>
void interpolate(const Cpu&, const InterpolatePixel<T>& body) {
  for_each_index(body.s.pixels(), body);
}

template <typename T>
void interpolate_backward(const Cpu&, const InterpolateBackwardRast<T>& body) {
  for_each_index(body.s.pixels(), body);
}

/// Each thread owns a range of vertices and walks all pixels in order: no atomics, and the same
/// sums whatever the number of threads.
template <typename T>
void interpolate_backward(const Cpu&, const InterpolateBackwardAttributes<T>& body) {
  const int64_t vertices = body.s.vertices;
  const int64_t grain = std::max<int64_t>(1, vertices / std::max(1, at::get_num_threads()));
  at::parallel_for(0, vertices, grain, [&](int64_t first, int64_t last) {
    for (int64_t i = 0; i < body.s.pixels(); ++i) body.add(i, first, last);
  });
}

template <typename T>
void attribute_derivatives(const Cpu&, const AttributeDerivativesPixel<T>& body) {
  for_each_index(body.s.pixels(), body);
}

#define TT3D_INSTANTIATE(T)                                                                \
  template void interpolate(const Cpu&, const InterpolatePixel<T>&);                       \
  template void interpolate_backward(const Cpu&, const InterpolateBackwardRast<T>&);       \
  template void interpolate_backward(const Cpu&, const InterpolateBackwardAttributes<T>&); \
  template void attribute_derivatives(const Cpu&, const AttributeDerivativesPixel<T>&);
TT3D_INSTANTIATE(float)
TT3D_INSTANTIATE(double)
#undef TT3D_INSTANTIATE

}  // namespace tt3d::raster
