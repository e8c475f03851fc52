#include "random_math.h"
#include "tt3d/cuda.h"

namespace tt3d {

template void for_each_index(const Cuda&, int64_t, const device::UnitBlock&);
template void for_each_index(const Cuda&, int64_t, const device::RangeBlock&);
template void for_each_index(const Cuda&, int64_t, const device::NoiseBlock&);

}  // namespace tt3d
