#include "pixels_cpu.h"
#include "raster_kernels.h"
#include "rows_cpu.h"

namespace tt3d::raster {
namespace {

/// Adds the gradients of `count` adjacent pixels, from pixel i on, to the vertices of their
/// triangles. One lane per pixel.
template <typename T>
TT3D_HD void spread_row(const RasterizeBackwardPixel<T>& body, const T* clip, int64_t i, int count,
                        const Row<double>& px, double py, const PartSums<T>& sums) {
  typedef Row<WholeAs<T>> Mask;
  constexpr Mask kPlace = {0, 1, 2, 3};
  Row<T> grad[kLanes], shown[kLanes];
  const auto pixel = [&](int j) TT3D_INLINE { return std::min(j, count - 1); };
  load_rows(body.grad_rast + 4 * i, pixel, grad);
  load_rows(body.rast + 4 * i, pixel, shown);
  const Mask active = (kPlace < count) & (shown[3] != 0) & ((grad[0] != 0) | (grad[1] != 0));
  if (!any(active)) return;
  const Mask face = (__builtin_convertvector(shown[3], Mask) - 1) & active;

  FlatVertex<Row<double>> corner[3];
  int32_t vertex[3][kLanes];
  for (int k = 0; k < 3; ++k) {
    for (int j = 0; j < kLanes; ++j) {
      vertex[k][j] = body.faces[3 * static_cast<int64_t>(face[j]) + k];
    }
    corner[k] = load_vertices(clip, vertex[k]);
  }
  const auto [x, y, w] = rasterize_backward<Row<double>>(corner, px, Row<double>{} + py,
                                                         doubles<T>(grad[0]), doubles<T>(grad[1]));
  const auto wide = __builtin_convertvector(active, Row<int64_t>);
  const auto masked = [&](const Row<double>& v) TT3D_INLINE { return wide ? v : Row<double>{}; };
  const Row<double> step[3] = {masked(x), masked(y), masked(w)};
  const Row<double> u = doubles<T>(shown[0]), v = doubles<T>(shown[1]);
  const Row<double> weight[3] = {u, v, 1 - u - v};
  for (int j = 0; j < kLanes; ++j) sums.touch(vertex[0][j], vertex[1][j], vertex[2][j]);
  for (int k = 0; k < 3; ++k) {
    const auto share = [&](int axis) TT3D_INLINE {
      return __builtin_convertvector(weight[k] * step[axis], Row<T>);
    };
    Row<T> rows[kLanes] = {share(0), share(1), {}, share(2)};  // gradients of z are 0
    transpose<T>(rows);
    for (int j = 0; j < kLanes; ++j) {
      add_row<T>(sums.rows + 4 * static_cast<int64_t>(vertex[k][j]), rows[j]);
    }
  }
}

/// Adds the gradients of pixels [first,last) of a view to the sums of its vertices, in pixel order.
/// (The arguments are copies: the compiler knows that no write changes them, and keeps them in
/// registers.)
template <typename T>
TT3D_HD void spread_pixels(const RasterizeBackwardPixel<T> body, int64_t view, int64_t first,
                           int64_t last, const PartSums<T> sums) {
  constexpr Row<double> kPlace = {0, 1, 2, 3};
  const int64_t width = body.s.width, offset = view * body.s.height * width;
  const T* clip = body.clip + view * body.s.vertices * 4;
  for (int64_t y = first / width; y * width < last; ++y) {
    const int64_t row = y * width, end = std::min(last - row, width);
    const double py = pixel_y(y, body.s.height);
    const auto spread = [&](int64_t x, int count) TT3D_INLINE {
      const Row<double> px = pixel_x(static_cast<double>(x) + kPlace, width);
      spread_row(body, clip, offset + row + x, count, px, py, sums);
    };
    int64_t x = std::max<int64_t>(first - row, 0);
    for (; x + kLanes <= end; x += kLanes) spread(x, kLanes);
    if (x < end) spread(x, static_cast<int>(end - x));
  }
}

// Macros, because target_clones does not apply to templates.
#define TT3D_SPREAD_LOOP(T)                                                              \
  TT3D_CPU_LOOP void spread_loop(const RasterizeBackwardPixel<T>& body, int64_t view,    \
                                 int64_t first, int64_t last, const PartSums<T>& sums) { \
    spread_pixels(body, view, first, last, sums);                                        \
  }
TT3D_SPREAD_LOOP(float)
TT3D_SPREAD_LOOP(double)
#undef TT3D_SPREAD_LOOP

}  // namespace

template <typename T>
void scatter(const Cpu&, const RasterizeBackwardPixel<T>& body) {
  const auto add = [&](int64_t view, int64_t first, int64_t last, const PartSums<T>& sums) {
    spread_loop(body, view, first, last, sums);
  };
  scatter_in_parts(body.s.views, body.s.height * body.s.width, {body.s.vertices, 4, 4},
                   body.grad_clip, add);
}

template void scatter(const Cpu&, const RasterizeBackwardPixel<float>&);
template void scatter(const Cpu&, const RasterizeBackwardPixel<double>&);

}  // namespace tt3d::raster
