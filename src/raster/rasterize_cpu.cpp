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

/// Neighbouring pixels that are tested at once: most triangles of a fine mesh fit into one or two
/// such blocks. A vector is a row of one. (Vectors of two rows would be slower: the compiler knows
/// no vector longer than four doubles when it takes their operators apart.)
constexpr int kColumns = 4, kRows = 2;
typedef double Lanes __attribute__((vector_size(kColumns * sizeof(double))));
typedef int64_t LaneMask __attribute__((vector_size(kColumns * sizeof(int64_t))));
typedef int8_t LaneBytes __attribute__((vector_size(kColumns)));
constexpr Lanes kColumnOfLane = {0, 1, 2, 3};

/// The values of a triangle's functions in a row of a block.
struct RowValues {
  Lanes e[3], zw;
};

/// The lowest bit of each byte.
constexpr uint64_t kOneEach = 0x0101010101010101;

/// A byte for each lane of both rows, 0 or 255: lane 0 of the first row is the lowest.
TT3D_HD uint64_t bytes_of(const LaneMask (&rows)[kRows]) {
  uint32_t words[kRows];
  static_assert(sizeof(LaneBytes) == sizeof(uint32_t));
  for (int r = 0; r < kRows; ++r) {
    const LaneBytes bytes = __builtin_convertvector(rows[r], LaneBytes);
    std::memcpy(&words[r], &bytes, sizeof words[r]);
  }
  return words[0] | static_cast<uint64_t>(words[1]) << 32;
}

/// The lanes of a block's first columns and rows, as bytes_of.
TT3D_HD uint64_t first_lanes(int columns, int rows) {
  const uint64_t row = columns < kColumns ? (1ULL << (8 * columns)) - 1 : 0xFFFFFFFF;
  return rows < kRows ? row : row | row << 32;
}

/// Which of a block's lanes lie inside a triangle, as bytes_of.
TT3D_HD uint64_t inside_lanes(const TriangleSetup& t, const RowValues (&row)[kRows],
                              uint64_t lanes) {
  LaneMask within[kRows], tied[kRows];
  for (int r = 0; r < kRows; ++r) {
    const Lanes smallest = least(row[r].e[0], row[r].e[1], row[r].e[2]);
    within[r] = smallest > 0;
    tied[r] = smallest == 0;
  }
  uint64_t found = bytes_of(within) & lanes;
  for (uint64_t ties = bytes_of(tied) & lanes & kOneEach; ties != 0; ties &= ties - 1) {
    const int bit = __builtin_ctzll(ties), r = bit / 32, i = bit % 32 / 8;
    const double at[3] = {row[r].e[0][i], row[r].e[1][i], row[r].e[2][i]};
    if (inside(t, at)) found |= 1ULL << bit;
  }
  return found;
}

/// Draws a triangle in the lanes of a block. depth and out: of its first pixel. Triangles come in
/// order: at equal depth the lower index stays.
template <typename T>
TT3D_HD void draw_block(const TriangleSetup& t, int64_t face, int64_t width, uint64_t lanes,
                        const RowValues (&row)[kRows], double* depth, T* out) {
  LaneMask nearer[kRows];
  for (int r = 0; r < kRows; ++r) {
    Lanes shown;
    std::memcpy(&shown, depth + r * width, sizeof shown);
    nearer[r] = in_depth(row[r].zw) & (row[r].zw < shown);
  }
  uint64_t left = inside_lanes(t, row, lanes & bytes_of(nearer)) & kOneEach;
  if (left == 0) return;
  Lanes u[kRows], v[kRows];
  for (int r = 0; r < kRows; ++r) {
    const Lanes scale = 1 / (row[r].e[0] + row[r].e[1] + row[r].e[2]);
    u[r] = row[r].e[0] * scale;
    v[r] = row[r].e[1] * scale;
  }
  const T number = static_cast<T>(face + 1);
  for (; left != 0; left &= left - 1) {
    const int bit = __builtin_ctzll(left), r = bit / 32, i = bit % 32 / 8;
    const int64_t pixel = r * width + i;
    depth[pixel] = row[r].zw[i];
    T* to = out + 4 * pixel;
    to[0] = static_cast<T>(u[r][i]);
    to[1] = static_cast<T>(v[r][i]);
    to[2] = static_cast<T>(row[r].zw[i]);
    to[3] = number;
  }
}

template <typename T>
TT3D_HD void draw_triangle(const TriangleSetup& t, int64_t face, const Sizes& s,
                           const Band<T>& band) {
  for (int x = t.x_begin; x < t.x_end; x += kColumns) {
    const Lanes px = pixel_x(x + kColumnOfLane, s.width);
    Lanes of_column[4];
    for (int k = 0; k < 3; ++k) of_column[k] = t.edge[k].of_column(px);
    of_column[3] = t.depth.of_column(px);
    for (int y = t.y_begin; y < t.y_end; y += kRows) {
      RowValues row[kRows];
      for (int r = 0; r < kRows; ++r) {
        const double py = pixel_y(y + r, s.height);
        for (int k = 0; k < 3; ++k) row[r].e[k] = of_column[k] + t.edge[k].of_row(py);
        row[r].zw = of_column[3] + t.depth.of_row(py);
      }
      draw_block(t, face, s.width, first_lanes(t.x_end - x, t.y_end - y), row,
                 band.depth + (y - band.y_begin) * s.width + x, band.rast + 4 * (y * s.width + x));
    }
  }
}

/// All triangles of a view, in order: neighbours in a mesh are neighbours on the screen, so the
/// band stays in the cache without sorting triangles into tiles first.
template <typename T>
TT3D_HD void draw_band(const T* clip, const int32_t* faces, const VertexBounds* points,
                       const Sizes& s, const Band<T>& band) {
  TriangleSetup setup;
  for (int64_t f = 0; f < s.faces; ++f) {
    const int32_t* face = faces + 3 * f;
    if (!set_bounds(points[face[0]], points[face[1]], points[face[2]], setup)) {
      continue;
    }
    setup.y_begin = std::max(setup.y_begin, band.y_begin);
    setup.y_end = std::min(setup.y_end, band.y_end);
    if (setup.y_begin >= setup.y_end || !set_functions(clip, face, setup)) continue;
    draw_triangle(setup, f, s, band);
  }
}

/// Adds the gradients of pixels [first,last) of a view to its vertices' sums, in their order.
/// Neighbouring pixels of one triangle are summed first: they load and store its vertices once.
template <typename T>
TT3D_HD void spread_pixels(const RasterizeBackwardPixel<T>& body, int64_t view, int64_t first,
                           int64_t last, T* sums) {
  const int64_t offset = view * body.s.height * body.s.width;
  const T* clip = body.clip + view * body.s.vertices * 4;
  int64_t shown = -1;
  ClipTriangle triangle = {};
  TriangleRows rows;
  for (int64_t y = first / body.s.width; y * body.s.width < last; ++y) {
    const int64_t row = y * body.s.width, end = std::min(last - row, body.s.width);
    const double py = pixel_y(y, body.s.height);
    for (int64_t x = std::max<int64_t>(first - row, 0); x < end; ++x) {
      const int64_t i = offset + row + x, face = body.face_at(i);
      if (face < 0) continue;
      if (face != shown) {
        if (shown >= 0) body.spread(shown, rows, sums);
        triangle = load_triangle(clip, body.faces + 3 * face);
        rows = {};
        shown = face;
      }
      body.add_pixel(i, triangle, pixel_x(x, body.s.width), py, rows);
    }
  }
  if (shown >= 0) body.spread(shown, rows, sums);
}

// target_clones needs plain functions.
#define TT3D_RASTERIZE_LOOPS(T)                                                                 \
  TT3D_CPU_LOOP void draw_loop(const T* clip, const int32_t* faces, const VertexBounds* points, \
                               const Sizes& s, const Band<T>& band) {                           \
    draw_band(clip, faces, points, s, band);                                                    \
  }                                                                                             \
  TT3D_CPU_LOOP void place_loop(const T* clip, const Sizes& s, VertexBounds* points) {          \
    for (int64_t v = 0; v < s.vertices; ++v) {                                                  \
      points[v] = vertex_bounds(load_vertex(clip, v), s.height, s.width);                       \
    }                                                                                           \
  }                                                                                             \
  TT3D_CPU_LOOP void spread_loop(const RasterizeBackwardPixel<T>& body, int64_t view,           \
                                 int64_t first, int64_t last, T* sums) {                        \
    spread_pixels(body, view, first, last, sums);                                               \
  }
TT3D_RASTERIZE_LOOPS(float)
TT3D_RASTERIZE_LOOPS(double)
#undef TT3D_RASTERIZE_LOOPS

/// Rows [y_begin,y_end) of a view, whose pixels start at `rast`.
template <typename T>
void draw_rows(const T* clip, const int32_t* faces, T* rast, int64_t y_begin, int64_t y_end,
               const Sizes& s) {
  // Blocks read beyond a row's end, and one row further.
  std::vector<double> depth((y_end - y_begin + 1) * s.width + kColumns,
                            std::numeric_limits<double>::infinity());
  // A vertex is shared by six triangles or so.
  const auto points = std::make_unique_for_overwrite<VertexBounds[]>(s.vertices);
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
