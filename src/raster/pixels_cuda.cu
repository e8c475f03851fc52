#include "raster_kernels.h"
#include "tt3d/cuda.h"

// Bodies that run on the GPU with one thread per pixel, texel or face.
namespace tt3d {

#define TT3D_INSTANTIATE(T)                                                                        \
  template void for_each_index(const Cuda&, int64_t, const raster::PaintPixel<T>&);                \
  template void for_each_index(const Cuda&, int64_t, const raster::PaintBackwardPixel<T>&);        \
  template void for_each_index(const Cuda&, int64_t, const raster::InterpolatePixel<T>&);          \
  template void for_each_index(const Cuda&, int64_t, const raster::AttributeDerivativesPixel<T>&); \
  template void for_each_index(const Cuda&, int64_t, const raster::FacingFace<T>&);                \
  template void for_each_index(const Cuda&, int64_t, const raster::AntialiasPixel<T>&);            \
  template void for_each_index(const Cuda&, int64_t, const raster::AntialiasBackwardPixel<T>&);    \
  template void for_each_index(const Cuda&, int64_t, const raster::HalveTexel<T>&);                \
  template void for_each_index(const Cuda&, int64_t, const raster::FoldTexel<T>&);                 \
  template void for_each_index(const Cuda&, int64_t, const raster::TexturePixel<T>&);              \
  template void for_each_index(const Cuda&, int64_t, const raster::TextureBackwardPixel<T>&);
TT3D_INSTANTIATE(float)
TT3D_INSTANTIATE(double)
#undef TT3D_INSTANTIATE
template void for_each_index(const Cuda&, int64_t, const raster::SilhouetteEdges&);

}  // namespace tt3d
