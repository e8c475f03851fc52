#include "raster_kernels.h"
#include "tt3d/device.h"

namespace tt3d::raster {
namespace {

/// Views in parallel, the pixels of each in order: sums that pixels share get the same bytes with
/// any number of threads.
template <typename Body>
void for_each_view(const Sizes& s, const Body& body) {
  at::parallel_for(0, s.views, 1, [&](int64_t first, int64_t last) {
    for (int64_t n = first; n < last; ++n) {
      for (int64_t y = 0; y < s.height; ++y) {
        for (int64_t x = 0; x < s.width; ++x) body(PixelPlace{n, y, x});
      }
    }
  });
}

}  // namespace

template <typename T>
void scatter(const Cpu&, const AntialiasPixel<T>& body) {
  for_each_view(body.s, body);
}

template <typename T>
void scatter(const Cpu&, const AntialiasBackwardPixel<T>& body) {
  for_each_view(body.s, body);
}

template void scatter(const Cpu&, const AntialiasPixel<float>&);
template void scatter(const Cpu&, const AntialiasPixel<double>&);
template void scatter(const Cpu&, const AntialiasBackwardPixel<float>&);
template void scatter(const Cpu&, const AntialiasBackwardPixel<double>&);

}  // namespace tt3d::raster
