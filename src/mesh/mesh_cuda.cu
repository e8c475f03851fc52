#include "nearest_math.h"
#include "neighbor_math.h"
#include "tt3d/cuda.h"

namespace tt3d {

template void for_each_index(const Cuda&, int64_t, const mesh::NearestPoint&);
template void for_each_index(const Cuda&, int64_t, const mesh::NeighborDifferences<float>&);
template void for_each_index(const Cuda&, int64_t, const mesh::NeighborDifferences<double>&);
template void for_each_index(const Cuda&, int64_t, const mesh::NeighborDistances<float>&);
template void for_each_index(const Cuda&, int64_t, const mesh::NeighborDistances<double>&);

}  // namespace tt3d
