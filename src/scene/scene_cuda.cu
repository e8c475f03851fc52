#include "project_math.h"
#include "tt3d/cuda.h"

namespace tt3d {

template void for_each_index(const Cuda&, int64_t, const scene::ProjectVertex<float>&);
template void for_each_index(const Cuda&, int64_t, const scene::ProjectVertex<double>&);
template void for_each_index(const Cuda&, int64_t, const scene::ProjectBackwardVertex<float>&);
template void for_each_index(const Cuda&, int64_t, const scene::ProjectBackwardVertex<double>&);

}  // namespace tt3d
