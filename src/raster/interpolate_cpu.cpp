#include "raster_kernels.h"
#include "tt3d/device.h"

namespace tt3d::raster {

/// Each thread owns a range of vertices and walks all pixels in order: no atomics, and the same
/// sums whatever the number of threads.
template <typename T>
void scatter(const Cpu&, const InterpolateBackwardAttributes<T>& body) {
  const int64_t vertices = body.s.vertices, pixels = body.s.pixels();
  const int64_t grain = std::max<int64_t>(1, vertices / std::max(1, at::get_num_threads()));
  at::parallel_for(0, vertices, grain, [&](int64_t first, int64_t last) {
    for (int64_t i = 0; i < pixels; ++i) body.add(i, first, last);
  });
}

template void scatter(const Cpu&, const InterpolateBackwardAttributes<float>&);
template void scatter(const Cpu&, const InterpolateBackwardAttributes<double>&);

}  // namespace tt3d::raster
