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

/// Triangles are taken in batches: chosen by their bounds, set up many at once, then drawn.
constexpr int kBatch = 64;

/// Columns of the blocks of pixels that are tested at once: most triangles of a fine mesh fit into
/// one or two blocks.
constexpr int kColumns = 4, kRows = 2;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
/// The least depth beyond the far plane: what hides a pixel that shows nothing lies before it.
constexpr double kBeyond = 1 + std::numeric_limits<double>::epsilon();

template <typename T, int kCount>
struct VectorOf {
  typedef T Type __attribute__((vector_size(kCount * sizeof(T))));
};
template <typename T, int kCount>
using Vector = typename VectorOf<T, kCount>::Type;
template <typename T>
using Row = Vector<T, kColumns>;
/// Whole numbers of a number's size.
template <typename T>
using WholeAs = std::conditional_t<sizeof(T) == sizeof(int32_t), int32_t, int64_t>;

template <typename Vector, typename T>
TT3D_HD Vector load(const T* from) {
  Vector v;
  std::memcpy(&v, from, sizeof v);
  return v;
}

/// What rows [y_begin,y_end) of a view show, a plane for each number of a pixel: a block's row is a
/// vector in each. Blocks and vectors of rows reach beyond the last ones, and so do the planes.
template <typename T>
struct Band {
  int64_t width;
  int y_begin, y_end;
  std::vector<double> depth;   ///< kBeyond where nothing is shown
  std::vector<T> u, v, shown;  ///< shown: triangle + 1, or 0
  std::vector<double> px, py;  ///< coordinates of columns and rows
  Band(const Sizes& s, int64_t first, int64_t last)
      : width(s.width), y_begin(static_cast<int>(first)), y_end(static_cast<int>(last)) {
    const int64_t rows = last - first + kColumns, pixels = rows * width + kColumns;
    depth.resize(pixels, kBeyond);
    for (auto* plane : {&u, &v, &shown}) plane->resize(pixels);
    for (int64_t x = 0; x < width + kColumns; ++x) px.push_back(pixel_x(x, width));
    for (int64_t y = 0; y < rows; ++y) py.push_back(pixel_y(first + y, s.height));
  }
};

/// A batch, a row for each number, so that loops over its triangles become vectors.
template <typename T>
struct Batch {
  int count = 0;
  int32_t face[kBatch] = {};
  int x_begin[kBatch], x_end[kBatch], y_begin[kBatch], y_end[kBatch];
  T corner[3][4][kBatch];     ///< x, y, z, w of the vertices
  double edge[3][3][kBatch];  ///< a, b, c of their functions
  double depth[3][kBatch];    ///< and of the depth's
  bool drawn[kBatch];         ///< false where the functions are none

  [[nodiscard]] TT3D_HD ClipVertex vertex(int k, int i) const {
    return {static_cast<double>(corner[k][0][i]), static_cast<double>(corner[k][1][i]),
            static_cast<double>(corner[k][2][i]), static_cast<double>(corner[k][3][i])};
  }
  [[nodiscard]] TT3D_HD TriangleSetup setup(int i) const {
    TriangleSetup t;
    for (int k = 0; k < 3; ++k) t.edge[k] = {edge[k][0][i], edge[k][1][i], edge[k][2][i]};
    t.depth = {depth[0][i], depth[1][i], depth[2][i]};
    t.x_begin = x_begin[i];
    t.x_end = x_end[i];
    t.y_begin = y_begin[i];
    t.y_end = y_end[i];
    return t;
  }
};

/// Fills the batch with the next triangles from `face` on that may cover a pixel of the band;
/// returns the one after.
template <typename T>
TT3D_HD int64_t choose(const int32_t* faces, const VertexBounds* points, const Sizes& s,
                       const Band<T>& band, int64_t face, Batch<T>& batch) {
  batch.count = 0;
  for (; face < s.faces && batch.count < kBatch; ++face) {
    const int32_t* corner = faces + 3 * face;
    TriangleSetup t;
    const bool covers = set_bounds(points[corner[0]], points[corner[1]], points[corner[2]], t);
    const int i = batch.count;
    batch.face[i] = static_cast<int32_t>(face);
    batch.x_begin[i] = t.x_begin;
    batch.x_end[i] = t.x_end;
    batch.y_begin[i] = std::max(t.y_begin, band.y_begin);
    batch.y_end[i] = std::min(t.y_end, band.y_end);
    batch.count += covers & (batch.y_begin[i] < batch.y_end[i]);
  }
  return face;
}

/// Loads the vertices of four triangles from the i-th on, turning rows of vertices into the
/// batch's.
template <typename T>
TT3D_HD void load_four(const T* clip, const int32_t* faces, int i, Batch<T>& batch) {
  for (int k = 0; k < 3; ++k) {
    const auto vertex = [&](int j) TT3D_INLINE {
      return load<Row<T>>(
          clip + 4 * static_cast<int64_t>(faces[3 * static_cast<int64_t>(batch.face[i + j]) + k]));
    };
    const Row<T> a = vertex(0), b = vertex(1), c = vertex(2), d = vertex(3);
    const Row<T> ab_xy = __builtin_shufflevector(a, b, 0, 4, 1, 5);
    const Row<T> ab_zw = __builtin_shufflevector(a, b, 2, 6, 3, 7);
    const Row<T> cd_xy = __builtin_shufflevector(c, d, 0, 4, 1, 5);
    const Row<T> cd_zw = __builtin_shufflevector(c, d, 2, 6, 3, 7);
    const Row<T> rows[4] = {__builtin_shufflevector(ab_xy, cd_xy, 0, 1, 4, 5),
                            __builtin_shufflevector(ab_xy, cd_xy, 2, 3, 6, 7),
                            __builtin_shufflevector(ab_zw, cd_zw, 0, 1, 4, 5),
                            __builtin_shufflevector(ab_zw, cd_zw, 2, 3, 6, 7)};
    for (int m = 0; m < 4; ++m) std::memcpy(batch.corner[k][m] + i, &rows[m], sizeof rows[m]);
  }
}

/// Sets up the batch's triangles. (Those beyond the last are set up too, and not drawn.)
template <typename T>
TT3D_HD void set_up(const T* clip, const int32_t* faces, Batch<T>& batch) {
  constexpr int kStep = 8;
  static_assert(kBatch % kStep == 0);
  const int count = (batch.count + kStep - 1) / kStep * kStep;
  for (int i = 0; i < count; i += 4) load_four(clip, faces, i, batch);
  for (int i = 0; i < count; ++i) {
    ScreenFunction edge[3], depth;
    batch.drawn[i] = screen_functions(
        {{batch.vertex(0, i), batch.vertex(1, i), batch.vertex(2, i)}}, edge, depth);
    for (int k = 0; k < 3; ++k) {
      batch.edge[k][0][i] = edge[k].a;
      batch.edge[k][1][i] = edge[k].b;
      batch.edge[k][2][i] = edge[k].c;
    }
    batch.depth[0][i] = depth.a;
    batch.depth[1][i] = depth.b;
    batch.depth[2][i] = depth.c;
  }
}

/// Draws into a band, a block of pixels at a time. A vector is a row of one. (Vectors of two rows
/// would be slower: the compiler takes comparisons of more than four doubles apart.)
template <typename T>
struct Painter {
  typedef Row<double> Lanes;
  typedef Row<int64_t> Mask;
  /// The values of a triangle's functions: three edges', then the depth's.
  struct Values {
    Lanes of[4];
  };
  static constexpr Mask kPlace = {0, 1, 2, 3};

  Band<T>& band;

  TT3D_HD static bool any(const Mask& mask) {
    const auto bytes = __builtin_convertvector(mask, Row<int8_t>);
    uint32_t word;
    static_assert(sizeof bytes == sizeof word);
    std::memcpy(&word, &bytes, sizeof word);
    return word != 0;
  }

  /// Writes the lanes of a mask to a plane.
  template <typename Number>
  TT3D_HD static void put(const Row<Number>& value, const Row<WholeAs<Number>>& mask,
                          Number* plane) {
    typedef Row<WholeAs<Number>> Bits;
    const Bits row = (mask & reinterpret_cast<const Bits&>(value)) | (~mask & load<Bits>(plane));
    std::memcpy(plane, &row, sizeof row);
  }

  /// Takes from the lanes that a row hits those where an edge function is 0 and which lie outside.
  TT3D_HD static void settle_ties(const TriangleSetup& t, const Values& at, Mask& hit) {
    for (int i = 0; i < kColumns; ++i) {
      const double e[3] = {at.of[0][i], at.of[1][i], at.of[2][i]};
      if (!inside(t, e)) hit[i] = 0;
    }
  }

  /// Draws a triangle in a block, whose first pixel in the band is `first`. Triangles come in
  /// order: at equal depth the lower index stays.
  TT3D_HD void draw_block(const TriangleSetup& t, T number, const Values (&at)[kRows],
                          int64_t first) const {
    double* depth = band.depth.data() + first;
    Lanes smallest[kRows];
    Mask hit[kRows], some = {}, tied = {};
    for (int r = 0; r < kRows; ++r) {
      const Lanes& zw = at[r].of[3];
      smallest[r] = least(at[r].of[0], at[r].of[1], at[r].of[2]);
      hit[r] = (smallest[r] >= 0) & (zw >= -1) & (zw < load<Lanes>(depth + r * band.width));
      some |= hit[r];
    }
    if (!any(some)) return;
    for (int r = 0; r < kRows; ++r) tied |= hit[r] & (smallest[r] == 0);
    if (__builtin_expect(any(tied), 0)) {
      for (int r = 0; r < kRows; ++r) settle_ties(t, at[r], hit[r]);
    }
    for (int r = 0; r < kRows; ++r) put_row(number, at[r], hit[r], first + r * band.width);
  }

  TT3D_HD void put_row(T number, const Values& at, const Mask& hit, int64_t pixel) const {
    const Lanes scale = 1 / (at.of[0] + at.of[1] + at.of[2]);
    const auto lanes = __builtin_convertvector(hit, Row<WholeAs<T>>);
    put(at.of[3], hit, band.depth.data() + pixel);
    put(__builtin_convertvector(at.of[0] * scale, Row<T>), lanes, band.u.data() + pixel);
    put(__builtin_convertvector(at.of[1] * scale, Row<T>), lanes, band.v.data() + pixel);
    put(Row<T>{} + number, lanes, band.shown.data() + pixel);
  }

  /// The functions' parts of columns, or of rows, four at once. Beyond the triangle's bounds the
  /// depth is infinite: nothing is drawn there.
  TT3D_HD static Values parts_of_columns(const TriangleSetup& t, const Lanes& px, int count) {
    Values part;
    for (int k = 0; k < 3; ++k) part.of[k] = t.edge[k].of_column(px);
    part.of[3] = kPlace < count ? t.depth.of_column(px) : Lanes{} + kInfinity;
    return part;
  }
  TT3D_HD static Values parts_of_rows(const TriangleSetup& t, const Lanes& py, int count) {
    Values part;
    for (int k = 0; k < 3; ++k) part.of[k] = t.edge[k].of_row(py);
    part.of[3] = kPlace < count ? t.depth.of_row(py) : Lanes{} + kInfinity;
    return part;
  }

  TT3D_HD void draw_triangle(const TriangleSetup& t, T number) const {
    for (int x = t.x_begin; x < t.x_end; x += kColumns) {
      const Values column = parts_of_columns(t, load<Lanes>(band.px.data() + x), t.x_end - x);
      for (int y = t.y_begin; y < t.y_end; y += kRows) {
        const int64_t line = y - band.y_begin;
        const Values row = parts_of_rows(t, load<Lanes>(band.py.data() + line), t.y_end - y);
        Values at[kRows];
        for (int r = 0; r < kRows; ++r) {
          for (int k = 0; k < 4; ++k) at[r].of[k] = column.of[k] + row.of[k][r];
        }
        draw_block(t, number, at, line * band.width + x);
      }
    }
  }
};

/// All triangles of a view, in order: neighbours in a mesh are neighbours on the screen, so the
/// band stays in the cache without sorting triangles into tiles first.
template <typename T>
TT3D_HD void draw_band(const T* clip, const int32_t* faces, const VertexBounds* points,
                       const Sizes& s, Band<T>& band) {
  const Painter<T> painter = {band};
  Batch<T> batch;
  for (int64_t f = 0; f < s.faces;) {
    f = choose(faces, points, s, band, f, batch);
    set_up(clip, faces, batch);
    for (int i = 0; i < batch.count; ++i) {
      if (batch.drawn[i]) painter.draw_triangle(batch.setup(i), static_cast<T>(batch.face[i] + 1));
    }
  }
}

/// Turns a band's planes into rows of pixels.
template <typename T>
TT3D_HD void write_pixels(const Band<T>& band, T* __restrict rast) {
  const int64_t count = (band.y_end - band.y_begin) * band.width;
  const double* depth = band.depth.data();
  const T *u = band.u.data(), *v = band.v.data(), *shown = band.shown.data();
  for (int64_t i = 0; i < count; ++i) {
    rast[4 * i] = u[i];
    rast[4 * i + 1] = v[i];
    rast[4 * i + 2] = shown[i] != 0 ? static_cast<T>(depth[i]) : T(0);
    rast[4 * i + 3] = shown[i];
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
      const double px = pixel_x(x, body.s.width);  // here, so that its division leaves the loop
      if (face < 0) continue;
      if (face != shown) {
        if (shown >= 0) body.spread(shown, rows, sums);
        triangle = load_triangle(clip, body.faces + 3 * face);
        rows = {};
        shown = face;
      }
      body.add_pixel(i, triangle, px, py, rows);
    }
  }
  if (shown >= 0) body.spread(shown, rows, sums);
}

// target_clones needs plain functions.
#define TT3D_RASTERIZE_LOOPS(T)                                                                 \
  TT3D_CPU_LOOP void place_loop(const T* clip, const Sizes& s, int64_t first, int64_t last,     \
                                VertexBounds* points) {                                         \
    for (int64_t v = first; v < last; ++v) {                                                    \
      points[v] = vertex_bounds(load_vertex(clip, v), s.height, s.width);                       \
    }                                                                                           \
  }                                                                                             \
  TT3D_CPU_LOOP void draw_loop(const T* clip, const int32_t* faces, const VertexBounds* points, \
                               const Sizes& s, Band<T>& band) {                                 \
    draw_band(clip, faces, points, s, band);                                                    \
  }                                                                                             \
  TT3D_CPU_LOOP void write_loop(const Band<T>& band, T* rast) { write_pixels(band, rast); }     \
  TT3D_CPU_LOOP void spread_loop(const RasterizeBackwardPixel<T>& body, int64_t view,           \
                                 int64_t first, int64_t last, T* sums) {                        \
    spread_pixels(body, view, first, last, sums);                                               \
  }
TT3D_RASTERIZE_LOOPS(float)
TT3D_RASTERIZE_LOOPS(double)
#undef TT3D_RASTERIZE_LOOPS

/// Rows [y_begin,y_end) of a view, whose pixels start at `rast`. points: of its vertices.
template <typename T>
void draw_rows(const T* clip, const int32_t* faces, const VertexBounds* points, T* rast,
               int64_t y_begin, int64_t y_end, const Sizes& s) {
  Band<T> band(s, y_begin, y_end);
  draw_loop(clip, faces, points, s, band);
  write_loop(band, rast + 4 * y_begin * s.width);
}

}  // namespace

/// A thread draws whole views, or bands of one where there are more threads than views.
template <typename T>
void rasterize(const Cpu&, const T* clip, const int32_t* faces, T* rast, const Sizes& s) {
  constexpr int64_t kLeastRows = 16;
  const int64_t share = at::get_num_threads() / std::max<int64_t>(1, s.views);
  const int64_t bands = std::clamp<int64_t>(share, 1, std::max<int64_t>(1, s.height / kLeastRows));
  // A vertex is shared by six triangles or so, and by all bands.
  const auto points = std::make_unique_for_overwrite<VertexBounds[]>(s.views * s.vertices);
  at::parallel_for(0, s.views * s.vertices, 4096, [&](int64_t first, int64_t last) {
    place_loop(clip, s, first, last, points.get());
  });
  for_each_task(s.views * bands, [&](int64_t i) {
    const int64_t n = i / bands, band = i % bands;
    draw_rows(clip + n * s.vertices * 4, faces, points.get() + n * s.vertices,
              rast + n * s.height * s.width * 4, band * s.height / bands,
              (band + 1) * s.height / bands, s);
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
