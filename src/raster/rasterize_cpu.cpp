#include <algorithm>
#include <cstring>
#include <limits>
#include <memory>
#include <vector>

#include "pixels_cpu.h"
#include "raster_kernels.h"

// Compiled with -ffp-contract=off: both triangles at an edge must see the same bits.
namespace tt3d::raster {
namespace {

/// Rows [y_begin,y_end) of a view, and the depth of what they show.
template <typename T>
struct Band {
  T* rast;        ///< of the view
  double* depth;  ///< of the band
  int y_begin, y_end;
};

/// Neighbouring pixels of a row that are tested at once.
constexpr int kLanes = 4;
typedef double Lanes __attribute__((vector_size(kLanes * sizeof(double))));
typedef int64_t LaneMask __attribute__((vector_size(kLanes * sizeof(int64_t))));
typedef int8_t LaneBytes __attribute__((vector_size(kLanes)));

/// A byte for each of the first `count` lanes, that of lane 0 lowest; 0 where the mask is.
TT3D_HD uint32_t bytes_of(const LaneMask& mask, int count) {
  static_assert(kLanes == sizeof(uint32_t));
  const LaneBytes bytes = __builtin_convertvector(mask, LaneBytes);
  uint32_t word;
  std::memcpy(&word, &bytes, sizeof word);
  return count < kLanes ? word & ((1U << (8 * count)) - 1) : word;
}

/// The lanes in which a triangle is the nearest so far, as bytes_of. Triangles come in order: at
/// equal depth the lower index stays.
TT3D_HD uint32_t shown_lanes(const TriangleSetup& t, const Lanes e[3], const double* depth,
                             int count, Lanes& zw) {
  Lanes shown;
  std::memcpy(&shown, depth, sizeof shown);
  const LaneMask nearer = depth_at(t, e, zw) & (zw < shown);
  uint32_t lanes = bytes_of(strictly_inside(e) & nearer, count);
  for (uint32_t ties = bytes_of(on_an_edge(e) & nearer, count); ties != 0; ties &= ties - 1) {
    const int i = __builtin_ctz(ties);
    const double at[3] = {e[0][i / 8], e[1][i / 8], e[2][i / 8]};
    if (inside(t, at)) lanes |= 1U << i;
  }
  return lanes;
}

/// Draws a triangle in a row's lanes. depth and out: of the first one's pixel.
template <typename T>
TT3D_HD void draw_lanes(const TriangleSetup& t, int64_t face, int count, const Lanes e[3],
                        double* depth, T* out) {
  Lanes zw;
  uint32_t left = shown_lanes(t, e, depth, count, zw);
  if (left == 0) return;
  const Lanes scale = 1 / (e[0] + e[1] + e[2]);
  const Lanes u = e[0] * scale, v = e[1] * scale;
  for (int i = 0; left != 0; ++i, left >>= 8) {
    if ((left & 0xFF) == 0) continue;
    depth[i] = zw[i];
    out[4 * i] = static_cast<T>(u[i]);
    out[4 * i + 1] = static_cast<T>(v[i]);
    out[4 * i + 2] = static_cast<T>(zw[i]);
    out[4 * i + 3] = static_cast<T>(face + 1);
  }
}

template <typename T>
TT3D_HD void draw_triangle(const TriangleSetup& t, int64_t face, const Sizes& s,
                           const Band<T>& band) {
  for (int x = t.x_begin; x < t.x_end; x += kLanes) {
    Lanes px, of_column[3];
    for (int i = 0; i < kLanes; ++i) px[i] = pixel_x(x + i, s.width);
    for (int k = 0; k < 3; ++k) of_column[k] = t.edge[k].of_column(px);
    for (int y = t.y_begin; y < t.y_end; ++y) {
      const double py = pixel_y(y, s.height);
      Lanes e[3];
      for (int k = 0; k < 3; ++k) e[k] = of_column[k] + t.edge[k].of_row(py);
      draw_lanes(t, face, t.x_end - x, e, band.depth + (y - band.y_begin) * s.width + x,
                 band.rast + 4 * (y * s.width + x));
    }
  }
}

/// All triangles of a view, in order: neighbours in a mesh are neighbours on the screen, so the
/// band stays in the cache without sorting triangles into tiles first.
template <typename T>
TT3D_HD void draw_band(const T* clip, const int32_t* faces, const ScreenPoint* points,
                       const Sizes& s, const Band<T>& band) {
  TriangleSetup setup;
  for (int64_t f = 0; f < s.faces; ++f) {
    const int32_t* face = faces + 3 * f;
    if (!set_bounds(points[face[0]], points[face[1]], points[face[2]], s.height, s.width, setup)) {
      continue;
    }
    setup.y_begin = std::max(setup.y_begin, band.y_begin);
    setup.y_end = std::min(setup.y_end, band.y_end);
    if (setup.y_begin >= setup.y_end) continue;
    set_edges(clip, face, setup);
    draw_triangle(setup, f, s, band);
  }
}

/// Pixels whose gradients are computed at once.
template <typename T>
struct LanePixels {
  FlatTriangle<Lanes> triangle;
  Lanes px, py, grad_u, grad_v;
  T* out[kLanes][3];  ///< where the vertices' gradients go

  TT3D_HD void set(int lane, const RasterizeBackwardPixel<T>& body, int64_t view, int64_t pixel,
                   T* sums) {
    const Sizes& s = body.s;
    const int64_t i = view * s.height * s.width + pixel;
    const int32_t* face = body.faces + 3 * (static_cast<int64_t>(body.rast[4 * i + 3]) - 1);
    const T* clip = body.clip + view * s.vertices * 4;
    for (int k = 0; k < 3; ++k) {
      const T* p = clip + static_cast<int64_t>(face[k]) * 4;
      triangle.x[k][lane] = static_cast<double>(p[0]);
      triangle.y[k][lane] = static_cast<double>(p[1]);
      triangle.w[k][lane] = static_cast<double>(p[3]);
      out[lane][k] = sums + static_cast<int64_t>(face[k]) * 4;
    }
    px[lane] = pixel_x(pixel % s.width, s.width);
    py[lane] = pixel_y(pixel / s.width, s.height);
    grad_u[lane] = static_cast<double>(body.grad_rast[4 * i]);
    grad_v[lane] = static_cast<double>(body.grad_rast[4 * i + 1]);
  }

  /// Adds the gradients of the first `count` lanes.
  TT3D_HD void add(int count) const {
    Lanes grad[3][4] = {};
    rasterize_backward(triangle, px, py, grad_u, grad_v, grad);
    for (int lane = 0; lane < count; ++lane) {
      for (int k = 0; k < 3; ++k) {
        for (int c = 0; c < 4; ++c) out[lane][k][c] += static_cast<T>(grad[k][c][lane]);
      }
    }
  }
};

/// Adds the gradients of pixels [first,last) of a view to its vertices' sums, in their order.
template <typename T>
TT3D_HD void spread_pixels(const RasterizeBackwardPixel<T>& body, int64_t view, int64_t first,
                           int64_t last, T* sums) {
  const int64_t offset = 4 * view * body.s.height * body.s.width;
  LanePixels<T> pixels = {};
  int count = 0;
  for (int64_t i = first; i < last; ++i) {
    const T* grad = body.grad_rast + offset + 4 * i;
    if (body.rast[offset + 4 * i + 3] == 0 || (grad[0] == 0 && grad[1] == 0)) continue;
    pixels.set(count++, body, view, i, sums);
    if (count < kLanes) continue;
    pixels.add(kLanes);
    count = 0;
  }
  pixels.add(count);
}

// target_clones needs plain functions.
#define TT3D_RASTERIZE_LOOPS(T)                                                                \
  TT3D_CPU_LOOP void draw_loop(const T* clip, const int32_t* faces, const ScreenPoint* points, \
                               const Sizes& s, const Band<T>& band) {                          \
    draw_band(clip, faces, points, s, band);                                                   \
  }                                                                                            \
  TT3D_CPU_LOOP void place_loop(const T* clip, const Sizes& s, ScreenPoint* points) {          \
    for (int64_t v = 0; v < s.vertices; ++v) {                                                 \
      points[v] = screen_point(load_vertex(clip, v), s.height, s.width);                       \
    }                                                                                          \
  }                                                                                            \
  TT3D_CPU_LOOP void spread_loop(const RasterizeBackwardPixel<T>& body, int64_t view,          \
                                 int64_t first, int64_t last, T* sums) {                       \
    spread_pixels(body, view, first, last, sums);                                              \
  }
TT3D_RASTERIZE_LOOPS(float)
TT3D_RASTERIZE_LOOPS(double)
#undef TT3D_RASTERIZE_LOOPS

/// Rows [y_begin,y_end) of a view, whose pixels start at `rast`.
template <typename T>
void draw_rows(const T* clip, const int32_t* faces, T* rast, int64_t y_begin, int64_t y_end,
               const Sizes& s) {
  // Lanes read beyond a row's end.
  std::vector<double> depth((y_end - y_begin) * s.width + kLanes,
                            std::numeric_limits<double>::infinity());
  // A vertex is shared by six triangles or so.
  const auto points = std::make_unique_for_overwrite<ScreenPoint[]>(s.vertices);
  place_loop(clip, s, points.get());
  draw_loop(clip, faces, points.get(), s,
            {rast, depth.data(), static_cast<int>(y_begin), static_cast<int>(y_end)});
}

}  // namespace

/// A thread draws whole views, or bands of one where there are more threads than views.
template <typename T>
void rasterize(const Cpu&, const T* clip, const int32_t* faces, T* rast, const Sizes& s) {
  constexpr int64_t kLeastRows = 16;
  const int64_t share = at::get_num_threads() / std::max<int64_t>(1, s.views);
  const int64_t bands = std::clamp<int64_t>(share, 1, std::max<int64_t>(1, s.height / kLeastRows));
  at::parallel_for(0, s.views * bands, 1, [&](int64_t first, int64_t last) {
    for (int64_t i = first; i < last; ++i) {
      const int64_t n = i / bands, band = i % bands;
      draw_rows(clip + n * s.vertices * 4, faces, rast + n * s.height * s.width * 4,
                band * s.height / bands, (band + 1) * s.height / bands, s);
    }
  });
}

template <typename T>
void scatter(const Cpu&, const RasterizeBackwardPixel<T>& body) {
  const auto add = [&](int64_t view, int64_t first, int64_t last, T* sums) {
    spread_loop(body, view, first, last, sums);
  };
  scatter_in_parts(body.s.views, body.s.height * body.s.width, body.s.vertices, 4, body.grad_clip,
                   add);
}

template void rasterize(const Cpu&, const float*, const int32_t*, float*, const Sizes&);
template void rasterize(const Cpu&, const double*, const int32_t*, double*, const Sizes&);
template void scatter(const Cpu&, const RasterizeBackwardPixel<float>&);
template void scatter(const Cpu&, const RasterizeBackwardPixel<double>&);

}  // namespace tt3d::raster
