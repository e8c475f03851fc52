#include <algorithm>
#include <cstddef>
#include <cstring>
#include <limits>
#include <memory>
#include <vector>

#include "pixels_cpu.h"
#include "raster_kernels.h"
#include "rows_cpu.h"

// Compiled with -ffp-contract=off: both triangles at an edge must compute the same bits.
namespace tt3d::raster {
namespace {

/// Triangles are processed in batches: selected by their bounds, set up together, then drawn.
constexpr int kBatch = 64;

/// A block is the pixels that are tested together. Most triangles of a fine mesh cover one or two
/// blocks.
constexpr int kColumns = kLanes, kRows = 2;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
/// Depth of an empty pixel: the smallest one beyond the far plane, so that every visible triangle
/// is nearer.
constexpr double kBeyond = 1 + std::numeric_limits<double>::epsilon();

/// A triangle and the pixel range that it may cover.
struct Candidate {
  int x_begin, y_begin, x_end, y_end;
  int32_t face;
};

typedef Row<int32_t> Bounds;  ///< x_begin, y_begin, x_end, y_end

/// The pixel range of a triangle from those of its vertices, as in set_bounds, in one vector.
TT3D_HD Bounds bounds_of(const VertexBounds& p, const VertexBounds& q, const VertexBounds& r) {
  static_assert(offsetof(VertexBounds, x_begin) == 0 && offsetof(VertexBounds, y_begin) == 4 &&
                offsetof(VertexBounds, x_past) == 8 && offsetof(VertexBounds, y_past) == 12);
  const auto a = load<Bounds>(&p.x_begin), b = load<Bounds>(&q.x_begin);
  const auto c = load<Bounds>(&r.x_begin);
  return __builtin_shufflevector(least(a, b, c), greatest(a, b, c), 0, 1, 6, 7);
}

TT3D_HD bool covers_any(const Bounds& b) {
  const Bounds ends = __builtin_shufflevector(b, b, 2, 3, 2, 3);
  const Row<int32_t> begins_before = b < ends;
  return load<int64_t>(reinterpret_cast<const int32_t*>(&begins_before)) == -1;
}

/// State of the pixels in one row of a block.
template <typename T>
struct Group {
  double depth[kColumns];                       ///< kBeyond at empty pixels
  T u[kColumns], v[kColumns], shown[kColumns];  ///< shown: triangle + 1, or 0
};

/// State of rows [y_begin,y_end) of a view. Blocks and vectors reach beyond the last row and
/// column; the memory is padded for that.
template <typename T>
struct Band {
  int64_t width;
  int64_t stride;  ///< groups per row
  int y_begin, y_end;
  std::vector<Group<T>> groups;
  std::vector<double> px, py;  ///< coordinates of columns and rows
  float middle;                ///< triangles beyond this depth are drawn last
  std::unique_ptr<Candidate[]> far;
  int64_t far_count = 0;
  Band(const Sizes& s, int64_t first, int64_t last, float middle_depth)
      : width(s.width),
        stride((s.width + kColumns - 1) / kColumns),
        y_begin(static_cast<int>(first)),
        y_end(static_cast<int>(last)),
        middle(middle_depth),
        far(std::make_unique_for_overwrite<Candidate[]>(s.faces)) {
    const int64_t rows = last - first + kColumns;
    Group<T> empty = {};
    std::fill_n(empty.depth, kColumns, kBeyond);
    groups.resize(rows * stride + 1, empty);
    for (int64_t x = 0; x < (stride + 1) * kColumns; ++x) px.push_back(pixel_x(x, width));
    for (int64_t y = 0; y < rows; ++y) py.push_back(pixel_y(first + y, s.height));
  }
};

/// A batch of triangles as a structure of arrays, so that the compiler vectorises loops over its
/// triangles.
template <typename T>
struct Batch {
  int count = 0;
  Candidate of[kBatch] = {};
  T corner[3][4][kBatch];     ///< x, y, z, w of the vertices
  double edge[3][3][kBatch];  ///< a, b, c of the edge functions
  double depth[3][kBatch];    ///< a, b, c of the depth function
  bool drawn[kBatch];         ///< false if the triangle has no valid functions

  [[nodiscard]] TT3D_HD ClipVertex vertex(int k, int i) const {
    return {static_cast<double>(corner[k][0][i]), static_cast<double>(corner[k][1][i]),
            static_cast<double>(corner[k][2][i]), static_cast<double>(corner[k][3][i])};
  }
  [[nodiscard]] TT3D_HD TriangleSetup setup(int i) const {
    TriangleSetup t;
    for (int k = 0; k < 3; ++k) t.edge[k] = {edge[k][0][i], edge[k][1][i], edge[k][2][i]};
    t.depth = {depth[0][i], depth[1][i], depth[2][i]};
    t.x_begin = of[i].x_begin;
    t.x_end = of[i].x_end;
    t.y_begin = of[i].y_begin;
    t.y_end = of[i].y_end;
    return t;
  }
};

/// Fills the batch with far triangles from the i-th on; returns the index after the last one taken.
template <typename T>
TT3D_HD int64_t choose_far(const Band<T>& band, int64_t i, Batch<T>& batch) {
  batch.count = static_cast<int>(std::min<int64_t>(kBatch, band.far_count - i));
  std::copy_n(band.far.get() + i, batch.count, batch.of);
  return i + batch.count;
}

/// Loads the vertices of four triangles from the i-th on, and transposes them into the batch's
/// arrays.
template <typename T>
TT3D_HD void load_four(const T* clip, const int32_t* faces, int i, Batch<T>& batch) {
  for (int k = 0; k < 3; ++k) {
    Row<T> rows[4];
    const auto vertex = [&](int j) TT3D_INLINE {
      return faces[3 * static_cast<int64_t>(batch.of[i + j].face) + k];
    };
    load_rows(clip, vertex, rows);
    for (int m = 0; m < 4; ++m) std::memcpy(batch.corner[k][m] + i, &rows[m], sizeof rows[m]);
  }
}

/// Sets up the batch's triangles. (Entries beyond the last triangle are set up too, but not drawn.)
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

/// Draws into a band, block by block. A vector holds one row of a block. (Vectors of two rows are
/// slower: the compiler splits comparisons of more than four doubles.)
template <typename T>
struct Painter {
  typedef Row<double> Lanes;
  typedef Row<int64_t> Mask;
  /// Edge function values and depth along one row of a block.
  struct Values {
    Lanes e[3];
    Lanes zw;
  };
  static constexpr Mask kPlace = {0, 1, 2, 3};

  // Members of the band. The compiler knows that no write changes these copies, and keeps them in
  // registers.
  Group<T>* groups;
  int64_t stride;
  int y_begin;
  const double *px, *py;

  explicit Painter(Band<T>& band)
      : groups(band.groups.data()),
        stride(band.stride),
        y_begin(band.y_begin),
        px(band.px.data()),
        py(band.py.data()) {}

  /// Narrows a mask to the lane size of T.
  TT3D_HD static Row<WholeAs<T>> narrow(const Mask& mask) {
    if constexpr (sizeof(T) == sizeof(double)) {
      return mask;
    } else {
      typedef int32_t Halves __attribute__((vector_size(sizeof(Mask))));
      const auto halves = reinterpret_cast<Halves>(mask);
      return __builtin_shufflevector(halves, halves, 0, 2, 4, 6);
    }
  }

  /// Writes the lanes that the mask selects.
  template <typename Number>
  TT3D_HD static void put(const Row<Number>& value, const Row<WholeAs<Number>>& mask, Number* to) {
    const Row<Number> row = mask ? value : load<Row<Number>>(to);
    std::memcpy(to, &row, sizeof row);
  }

  /// Removes lanes from `hit`: those on an edge (function value 0) that belong to the other side,
  /// and those at the depth already shown, unless the triangle's index is lower.
  TT3D_HD static Mask settle_ties(const TriangleSetup& t, T number, const Values at,
                                  const Group<T>& group, Mask hit) {
    for (int i = 0; i < kColumns; ++i) {
      const double e[3] = {at.e[0][i], at.e[1][i], at.e[2][i]};
      const bool behind = at.zw[i] == group.depth[i] && number > group.shown[i];
      if (behind || !inside(t, e)) hit[i] = 0;
    }
    return hit;
  }

  /// Draws a triangle in a block; `group` is the block's first row.
  TT3D_HD void draw_block(const TriangleSetup& t, T number, const Values (&at)[kRows],
                          Group<T>* group) const {
    Mask hit[kRows], some = {}, tied = {};
    for (int r = 0; r < kRows; ++r) {
      const auto shown = load<Lanes>(group[r * stride].depth);
      const Lanes smallest = least(at[r].e[0], at[r].e[1], at[r].e[2]);
      hit[r] = (smallest >= 0) & (at[r].zw >= -1) & (at[r].zw <= shown);
      some |= hit[r];
      tied |= hit[r] & ((smallest == 0) | (at[r].zw == shown));
    }
    if (!any(some)) return;
    if (__builtin_expect(any(tied), 0)) {
      for (int r = 0; r < kRows; ++r) {
        hit[r] = settle_ties(t, number, at[r], group[r * stride], hit[r]);
      }
    }
    for (int r = 0; r < kRows; ++r) put_row(number, at[r], hit[r], group[r * stride]);
  }

  TT3D_HD static void put_row(T number, const Values& at, const Mask& hit, Group<T>& group) {
    const Lanes scale = 1 / (at.e[0] + at.e[1] + at.e[2]);
    const auto lanes = narrow(hit);
    put(at.zw, hit, group.depth);
    put(__builtin_convertvector(at.e[0] * scale, Row<T>), lanes, group.u);
    put(__builtin_convertvector(at.e[1] * scale, Row<T>), lanes, group.v);
    put(Row<T>{} + number, lanes, group.shown);
  }

  /// The depth function's terms for four columns or rows from `begin` on: `part` inside
  /// [first,last), infinity outside.
  TT3D_HD static Lanes within(const Lanes& part, int begin, int first, int last) {
    return (kPlace > first - begin - 1) & (kPlace < last - begin) ? part : Lanes{} + kInfinity;
  }
  TT3D_HD Lanes depth_of_columns(const TriangleSetup& t, int x) const {
    return within(t.depth.of_column(load<Lanes>(px + x)), x, t.x_begin, t.x_end);
  }
  TT3D_HD Lanes depth_of_rows(const TriangleSetup& t, int y) const {
    return within(t.depth.of_row(load<Lanes>(py + y - y_begin)), y, t.y_begin, t.y_end);
  }
  TT3D_HD Group<T>* group_at(int x, int y) const {
    return groups + (y - y_begin) * stride + static_cast<unsigned>(x) / kColumns;
  }

  /// Whether every pixel in the triangle's bounds already shows a nearer surface.
  TT3D_HD bool is_hidden(const TriangleSetup& t) const {
    constexpr int kAtOnce = 2;  // groups; nearly always enough for the whole triangle
    for (int x = t.x_begin & -kColumns; x < t.x_end; x += kAtOnce * kColumns) {
      for (int y = t.y_begin; y < t.y_end; y += kLanes) {
        const Group<T>* group = group_at(x, y);
        const Lanes row = depth_of_rows(t, y);
        Mask some = {};
        for (int i = 0; i < kAtOnce; ++i) {
          const Lanes column = depth_of_columns(t, x + i * kColumns);
          for (int r = 0; r < kLanes; ++r) {
            some |= column + row[r] <= load<Lanes>(group[r * stride + i].depth);
          }
        }
        if (any(some)) return false;
      }
    }
    return true;
  }

  /// Outside the triangle's bounds the depth is infinite, so nothing is drawn there. Blocks begin
  /// at group boundaries. A neighbouring triangle soon reads what this one writes, and store
  /// forwarding works only if load and store address the same bytes.
  TT3D_HD void draw_triangle(const TriangleSetup& t, T number) const {
    for (int x = t.x_begin & -kColumns; x < t.x_end; x += kColumns) {
      Values column;
      column.zw = depth_of_columns(t, x);
      for (int k = 0; k < 3; ++k) column.e[k] = t.edge[k].of_column(load<Lanes>(px + x));
      Group<T>* group = group_at(x, t.y_begin);
      for (int y = t.y_begin; y < t.y_end; y += kLanes, group += kLanes * stride) {
        Values row;
        row.zw = depth_of_rows(t, y);
        for (int k = 0; k < 3; ++k) row.e[k] = t.edge[k].of_row(load<Lanes>(py + y - y_begin));
        draw_rows<0>(t, number, column, row, group);
        if (y + kRows < t.y_end) draw_rows<kRows>(t, number, column, row, group);
      }
    }
  }

  /// Draws rows [kFirst, kFirst + kRows) of the four rows whose edge and depth terms `row` holds.
  template <int kFirst>
  TT3D_HD void draw_rows(const TriangleSetup& t, T number, const Values& column, const Values& row,
                         Group<T>* group) const {
    Values at[kRows];
    for (int r = 0; r < kRows; ++r) {
      at[r].zw = column.zw + row.zw[kFirst + r];
      for (int k = 0; k < 3; ++k) at[r].e[k] = column.e[k] + row.e[k][kFirst + r];
    }
    draw_block(t, number, at, group + kFirst * stride);
  }

  /// far: the batch holds far triangles. Nearer ones hide most of them, so their depth is tested
  /// first.
  TT3D_HD void draw_batch(const Batch<T>& batch, bool far) const {
    for (int i = 0; i < batch.count; ++i) {
      if (!batch.drawn[i]) continue;
      const TriangleSetup t = batch.setup(i);
      if (!far || !is_hidden(t)) draw_triangle(t, static_cast<T>(batch.of[i].face + 1));
    }
  }
};

/// Fills the batch with near triangles, from `face` on, that may cover a pixel of the band. Appends
/// the far triangles on the way to the band's list. Returns the face after the last one examined.
template <typename T>
TT3D_HD int64_t choose(const int32_t* faces, const VertexBounds* points, const Sizes& s,
                       const Painter<T>& painter, Band<T>& band, int64_t face, Batch<T>& batch) {
  const Bounds first = {0, band.y_begin, 0, 0};
  const Bounds last = {INT32_MAX, INT32_MAX, INT32_MAX, band.y_end};
  batch.count = 0;
  for (; face < s.faces && batch.count < kBatch; ++face) {
    const int32_t* corner = faces + 3 * face;
    const VertexBounds &p = points[corner[0]], &q = points[corner[1]], &r = points[corner[2]];
    Bounds bounds = bounds_of(p, q, r);
    bounds = bounds < first ? first : bounds;
    bounds = bounds > last ? last : bounds;
    Candidate candidate;
    std::memcpy(&candidate.x_begin, &bounds, sizeof bounds);
    candidate.face = static_cast<int32_t>(face);
    const bool drawn = covers_any(bounds) & (p.in_front | q.in_front | r.in_front);
    const bool far = p.depth > band.middle;
    batch.of[batch.count] = candidate;
    band.far[band.far_count] = candidate;
    const Group<T>* group = painter.group_at(candidate.x_begin, candidate.y_begin);
    for (int row = 0; row < 3; ++row) __builtin_prefetch(group + row * band.stride, 1);
    batch.count += drawn & !far;
    band.far_count += drawn & far;
  }
  return face;
}

/// Draws all triangles of a view: the near half first, since it hides most of the far half. Each
/// half is drawn in mesh order. Neighbours in a mesh are neighbours on the screen, so the band
/// stays in the cache without sorting triangles into tiles.
template <typename T>
TT3D_HD void draw_band(const T* clip, const int32_t* faces, const VertexBounds* points,
                       const Sizes& s, Band<T>& band) {
  const Painter<T> painter(band);
  Batch<T> batch;
  for (int64_t f = 0; f < s.faces;) {
    f = choose(faces, points, s, painter, band, f, batch);
    set_up(clip, faces, batch);
    painter.draw_batch(batch, false);
  }
  for (int64_t i = 0; i < band.far_count;) {
    i = choose_far(band, i, batch);
    set_up(clip, faces, batch);
    painter.draw_batch(batch, true);
  }
}

/// Copies a band's groups into rows of pixels.
template <typename T>
TT3D_HD void write_pixels(const Band<T>& band, T* rast) {
  for (int64_t line = 0; line < band.y_end - band.y_begin; ++line) {
    for (int64_t x = 0; x < band.width; x += kColumns) {
      const Group<T>& group = band.groups[line * band.stride + x / kColumns];
      const auto shown = load<Row<T>>(group.shown);
      const auto depth = __builtin_convertvector(load<Row<double>>(group.depth), Row<T>);
      Row<T> pixels[kColumns] = {load<Row<T>>(group.u), load<Row<T>>(group.v),
                                 shown != 0 ? depth : Row<T>{}, shown};
      transpose<T>(pixels);
      const int64_t count = std::min<int64_t>(kColumns, band.width - x);
      std::memcpy(rast + 4 * (line * band.width + x), pixels, count * sizeof pixels[0]);
    }
  }
}

// Macros, because target_clones does not apply to templates.
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
  TT3D_CPU_LOOP void write_loop(const Band<T>& band, T* rast) { write_pixels(band, rast); }
TT3D_RASTERIZE_LOOPS(float)
TT3D_RASTERIZE_LOOPS(double)
#undef TT3D_RASTERIZE_LOOPS

/// An approximate median depth of a view's vertices, from a sample. It decides the drawing order
/// only, not the result.
float middle_depth(const VertexBounds* points, int64_t count) {
  constexpr int64_t kSamples = 256;
  float sum = 0, in_front = 0;
  for (int64_t i = 0; i < count; i += std::max<int64_t>(1, count / kSamples)) {
    if (!points[i].in_front) continue;
    sum += points[i].depth;
    in_front += 1;
  }
  return sum / in_front;
}

/// Draws rows [y_begin,y_end) of a view, whose pixels start at `rast`; points: the bounds of its
/// vertices.
template <typename T>
void draw_rows(const T* clip, const int32_t* faces, const VertexBounds* points, T* rast,
               int64_t y_begin, int64_t y_end, const Sizes& s) {
  Band<T> band(s, y_begin, y_end, middle_depth(points, s.vertices));
  draw_loop(clip, faces, points, s, band);
  write_loop(band, rast + 4 * y_begin * s.width);
}

}  // namespace

/// A thread draws whole views, or bands of a view if there are more threads than views.
template <typename T>
void rasterize(const Cpu&, const T* clip, const int32_t* faces, T* rast, const Sizes& s) {
  constexpr int64_t kLeastRows = 16;
  const int64_t share = at::get_num_threads() / std::max<int64_t>(1, s.views);
  const int64_t bands = std::clamp<int64_t>(share, 1, std::max<int64_t>(1, s.height / kLeastRows));
  // Project each vertex once: about six triangles and all bands use the result.
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

template void rasterize(const Cpu&, const float*, const int32_t*, float*, const Sizes&);
template void rasterize(const Cpu&, const double*, const int32_t*, double*, const Sizes&);

}  // namespace tt3d::raster
