#include "place_math.h"
#include "tt3d/cuda.h"

namespace tt3d {

using attack::EachPixel;

#define TT3D_INSTANTIATE(T)                                                                        \
  template void for_each_index(const Cuda&, int64_t, const EachPixel<attack::PlacePixel<T>>&);     \
  template void for_each_index(const Cuda&, int64_t,                                               \
                               const EachPixel<attack::PlaceBackwardPixel<T>>&);                   \
  template void for_each_index(const Cuda&, int64_t, const EachPixel<attack::OverWhitePixel<T>>&); \
  template void for_each_index(const Cuda&, int64_t,                                               \
                               const EachPixel<attack::OverWhiteBackwardPixel<T>>&);
TT3D_INSTANTIATE(float)
TT3D_INSTANTIATE(double)
#undef TT3D_INSTANTIATE

}  // namespace tt3d
