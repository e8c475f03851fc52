#include <array>

#include "pixels_cpu.h"
#include "raster_kernels.h"

namespace tt3d::raster {
namespace {

/// Adds the gradients of pixels [first,last) of all views to `sums`, those of neighbours that show
/// the same triangle at once.
template <int64_t kChannels, typename T>
void add_runs(const InterpolateBackwardAttributes<T>& body, int64_t first, int64_t last, T* sums) {
  int64_t shown = -1;
  std::array<T, 3 * kChannels> grad = {};
  const auto add_shown = [&] {
    for (int64_t i = 0; shown >= 0 && i < 3 * kChannels; ++i) {
      const int64_t vertex = body.faces[3 * shown + i / kChannels];
      sums[vertex * kChannels + i % kChannels] += grad[i];
    }
  };
  for (int64_t i = first; i < last; ++i) {
    const auto face = static_cast<int64_t>(body.rast[4 * i + 3]) - 1;
    if (face < 0) continue;
    if (face != shown) {
      add_shown();
      grad.fill(0);
      shown = face;
    }
    const T u = body.rast[4 * i], v = body.rast[4 * i + 1];
    const T weight[3] = {u, v, 1 - u - v};
    for (int64_t k = 0; k < 3 * kChannels; ++k) {
      grad[k] += weight[k / kChannels] * body.grad_out[i * kChannels + k % kChannels];
    }
  }
  add_shown();
}

}  // namespace

template <typename T>
void scatter(const Cpu&, const InterpolateBackwardAttributes<T>& body) {
  const auto add = [&](int64_t /*group*/, int64_t first, int64_t last, T* sums) {
    switch (body.s.channels) {
      case 2:
        return add_runs<2>(body, first, last, sums);
      case 3:
        return add_runs<3>(body, first, last, sums);
      case 4:
        return add_runs<4>(body, first, last, sums);
      default:
        for (int64_t i = first; i < last; ++i) body.add(i, sums);
    }
  };
  scatter_in_parts(1, body.s.pixels(), body.s.vertices, body.s.channels, body.grad_attributes, add);
}

template void scatter(const Cpu&, const InterpolateBackwardAttributes<float>&);
template void scatter(const Cpu&, const InterpolateBackwardAttributes<double>&);

}  // namespace tt3d::raster
