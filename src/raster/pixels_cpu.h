#pragma once

#include "rasterize_math.h"
#include "tt3d/device.h"

namespace tt3d::raster {

/// Views in parallel, the pixels of each in order: sums that the pixels of a view share get the
/// same bytes with any number of threads.
template <typename Body>
void for_each_pixel_in_order(const Sizes& s, const Body& body) {
  at::parallel_for(0, s.views, 1, [&](int64_t first, int64_t last) {
    for (int64_t n = first; n < last; ++n) {
      for (int64_t y = 0; y < s.height; ++y) {
        for (int64_t x = 0; x < s.width; ++x) body(PixelPlace{n, y, x});
      }
    }
  });
}

}  // namespace tt3d::raster
