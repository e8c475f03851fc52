#include "place_math.h"
#include "tt3d/cuda.h"

namespace tt3d {

using attack::EachPixel, attack::PlaceBackwardPixel, attack::PlacePixel;

template void for_each_index(const Cuda&, int64_t, const EachPixel<PlacePixel<float>>&);
template void for_each_index(const Cuda&, int64_t, const EachPixel<PlacePixel<double>>&);
template void for_each_index(const Cuda&, int64_t, const EachPixel<PlaceBackwardPixel<float>>&);
template void for_each_index(const Cuda&, int64_t, const EachPixel<PlaceBackwardPixel<double>>&);

}  // namespace tt3d
