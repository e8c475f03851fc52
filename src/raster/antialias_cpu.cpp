#include <algorithm>
#include <vector>

#include "pixels_cpu.h"
#include "raster_kernels.h"
#include "rows_cpu.h"

namespace tt3d::raster {
namespace {

/// Marks the pixels of a row whose face has a silhouette edge.
template <typename T>
void mark_row(const AntialiasView<T>& view, const T* rast, int64_t width, uint8_t* marks) {
  for (int64_t x = 0; x < width; ++x) {
    const auto face = static_cast<int64_t>(rast[4 * x + 3]) - 1;
    marks[x] = face >= 0 && view.silhouette[face] != 0;
  }
}

/// Views in parallel, the pixels of a view in order, so that sums have the same bytes with any
/// number of threads. Skips pixels with no mark at themselves, their right or their lower
/// neighbour, i.e. nearly all.
template <typename Body>
void for_each_marked_pixel(const Body& body) {
  constexpr int64_t kMarks = sizeof(uint64_t);
  const Sizes& s = body.s;
  for_each_task(s.views, [&](int64_t n) {
    // The marks of a row and of its padding, which are 0.
    std::vector<uint8_t> marks(s.width + kMarks + 1), below(marks);
    const auto view = body.scene.view(n, s);
    const auto* rast = body.scene.rast + n * s.height * s.width * 4;
    mark_row(view, rast, s.width, below.data());
    for (int64_t y = 0; y < s.height; ++y) {
      std::swap(marks, below);
      if (y + 1 < s.height) mark_row(view, rast + (y + 1) * s.width * 4, s.width, below.data());
      const uint8_t *here = marks.data(), *under = below.data();
      for (int64_t first = 0; first < s.width; first += kMarks) {
        if ((load<uint64_t>(here + first) | load<uint64_t>(here + first + 1) |
             load<uint64_t>(under + first)) == 0) {
          continue;
        }
        for (int64_t x = first; x < std::min(first + kMarks, s.width); ++x) {
          if (here[x] | here[x + 1] | under[x]) body(PixelPlace{n, y, x});
        }
      }
    }
  });
}

/// Faces [first,last) of all views, four faces of a view at once.
template <typename T>
TT3D_HD void face_range(const FacingFace<T>& body, int64_t first, int64_t last) {
  const Sizes& s = body.s;
  for (int64_t i = first; i < last;) {
    const int64_t view = view_of_face(i, s), end = std::min(last, (view + 1) * s.faces);
    const T* clip = body.clip + view * s.vertices * 4;
    for (; i + kLanes <= end; i += kLanes) {
      const int32_t* faces = body.faces + 3 * (i - view * s.faces);
      FlatVertex<Row<double>> corner[3];
      for (int k = 0; k < 3; ++k) {
        const int32_t vertex[kLanes] = {faces[k], faces[3 + k], faces[6 + k], faces[9 + k]};
        corner[k] = load_vertices(clip, vertex);
      }
      const auto turned = __builtin_convertvector(turn_of(corner) > 0, Row<uint8_t>) & 1;
      std::memcpy(body.facing + i, &turned, sizeof turned);
    }
    for (; i < end; ++i) body(i);
  }
}

// Macros, because target_clones does not apply to templates.
#define TT3D_FACING_LOOP(T)                                                                \
  TT3D_CPU_LOOP void facing_loop(const FacingFace<T>& body, int64_t first, int64_t last) { \
    face_range(body, first, last);                                                         \
  }
TT3D_FACING_LOOP(float)
TT3D_FACING_LOOP(double)
#undef TT3D_FACING_LOOP

}  // namespace

template <typename T>
void for_each_face(const Cpu&, const FacingFace<T>& body) {
  at::parallel_for(0, body.s.views * body.s.faces, 4096,
                   [&](int64_t first, int64_t last) { facing_loop(body, first, last); });
}

template <typename T>
void scatter(const Cpu&, const AntialiasPixel<T>& body) {
  for_each_marked_pixel(body);
}

template <typename T>
void scatter(const Cpu&, const AntialiasBackwardPixel<T>& body) {
  for_each_marked_pixel(body);
}

template void for_each_face(const Cpu&, const FacingFace<float>&);
template void for_each_face(const Cpu&, const FacingFace<double>&);
template void scatter(const Cpu&, const AntialiasPixel<float>&);
template void scatter(const Cpu&, const AntialiasPixel<double>&);
template void scatter(const Cpu&, const AntialiasBackwardPixel<float>&);
template void scatter(const Cpu&, const AntialiasBackwardPixel<double>&);

}  // namespace tt3d::raster
