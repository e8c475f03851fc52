#include <algorithm>
#include <vector>

#include "pixels_cpu.h"
#include "raster_kernels.h"

namespace tt3d::raster {
namespace {

/// Marks the pixels of a row that show a face with a silhouette edge; others may border on one.
template <typename T>
void mark_row(const AntialiasView<T>& view, const T* rast, int64_t width, uint8_t* marks) {
  for (int64_t x = 0; x < width; ++x) {
    const auto face = static_cast<int64_t>(rast[4 * x + 3]) - 1;
    marks[x] = face >= 0 && view.silhouette[face] != 0;
  }
}

/// Views in parallel, the pixels of each in order, so that sums get the same bytes with any number
/// of threads. Leaves out pixels without a silhouette there, to the right or below: nearly all.
template <typename Body>
void for_each_marked_pixel(const Body& body) {
  const Sizes& s = body.s;
  for_each_task(s.views, [&](int64_t n) {
    // A row's marks, and that of its pixel beyond the end.
    std::vector<uint8_t> marks(s.width + 1), below(s.width + 1);
    const auto view = body.scene.view(n, s);
    const auto* rast = body.scene.rast + n * s.height * s.width * 4;
    mark_row(view, rast, s.width, below.data());
    for (int64_t y = 0; y < s.height; ++y) {
      std::swap(marks, below);
      if (y + 1 < s.height) mark_row(view, rast + (y + 1) * s.width * 4, s.width, below.data());
      for (int64_t x = 0; x < s.width; ++x) {
        if (marks[x] | marks[x + 1] | below[x]) body(PixelPlace{n, y, x});
      }
    }
  });
}

}  // namespace

template <typename T>
void scatter(const Cpu&, const AntialiasPixel<T>& body) {
  for_each_marked_pixel(body);
}

template <typename T>
void scatter(const Cpu&, const AntialiasBackwardPixel<T>& body) {
  for_each_marked_pixel(body);
}

template void scatter(const Cpu&, const AntialiasPixel<float>&);
template void scatter(const Cpu&, const AntialiasPixel<double>&);
template void scatter(const Cpu&, const AntialiasBackwardPixel<float>&);
template void scatter(const Cpu&, const AntialiasBackwardPixel<double>&);

}  // namespace tt3d::raster
