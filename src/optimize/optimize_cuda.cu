#include "adam_math.h"
#include "tt3d/cuda.h"

namespace tt3d {

template void for_each_index(const Cuda&, int64_t, const optimize::AdamEntry&);

}  // namespace tt3d
