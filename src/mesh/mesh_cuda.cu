#include "nearest_math.h"
#include "tt3d/cuda.h"

namespace tt3d {

template void for_each_index(const Cuda&, int64_t, const mesh::NearestPoint&);

}  // namespace tt3d
