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

/// A triangle that may cover pixels, and which.
struct Candidate {
  int32_t face;
  int x_begin, x_end, y_begin, y_end;
};

/// What the pixels of a block's row show.
template <typename T>
struct Group {
  double depth[kColumns];                     ///< kBeyond where nothing is shown
  T u[kColumns], v[kColumns], shown[kColumns];  ///< shown: triangle + 1, or 0
};

/// What rows [y_begin,y_end) of a view show. Blocks and vectors of rows reach beyond the last row
/// and column, and so does the memory.
template <typename T>
struct Band {
  int64_t width;
  int64_t stride;  ///< groups from a row to the next
  int y_begin, y_end;
  std::vector<Group<T>> groups;
  std::vector<double> px, py;  ///< coordinates of columns and rows
  float middle;                ///< depth beyond which triangles are drawn last
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

/// A batch; what is computed has a row for each number, so that loops over its triangles become
/// vectors.
template <typename T>
struct Batch {
  int count = 0;
  Candidate of[kBatch] = {};
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
    t.x_begin = of[i].x_begin;
    t.x_end = of[i].x_end;
    t.y_begin = of[i].y_begin;
    t.y_end = of[i].y_end;
    return t;
  }
};

/// Fills the batch with the next near triangles from `face` on that may cover a pixel of the band,
/// and lists the far ones among them; returns the one after.
template <typename T>
TT3D_HD int64_t choose(const int32_t* faces, const VertexBounds* points, const Sizes& s,
                       Band<T>& band, int64_t face, Batch<T>& batch) {
  batch.count = 0;
  for (; face < s.faces && batch.count < kBatch; ++face) {
    const int32_t* corner = faces + 3 * face;
    TriangleSetup t;
    const VertexBounds& first = points[corner[0]];
    const bool covers = set_bounds(first, points[corner[1]], points[corner[2]], t);
    const Candidate candidate = {static_cast<int32_t>(face), t.x_begin, t.x_end,
                                 std::max(t.y_begin, band.y_begin),
                                 std::min(t.y_end, band.y_end)};
    const bool drawn = covers & (candidate.y_begin < candidate.y_end);
    const bool far = first.depth > band.middle;
    batch.of[batch.count] = candidate;
    band.far[band.far_count] = candidate;
    const Group<T>* group = band.groups.data() +
                            (candidate.y_begin - band.y_begin) * band.stride +
                            candidate.x_begin / kColumns;
    for (int r = 0; r < 3; ++r) __builtin_prefetch(group + r * band.stride, 1);
    batch.count += drawn & !far;
    band.far_count += drawn & far;
  }
  return face;
}

/// Fills the batch with far triangles from the i-th on; returns the one after.
template <typename T>
TT3D_HD int64_t choose_far(const Band<T>& band, int64_t i, Batch<T>& batch) {
  batch.count = static_cast<int>(std::min<int64_t>(kBatch, band.far_count - i));
  std::copy_n(band.far.get() + i, batch.count, batch.of);
  return i + batch.count;
}

/// Turns four rows of four numbers into four columns.
template <typename T>
TT3D_HD void transpose(Row<T> (&rows)[4]) {
  const Row<T> ab_xy = __builtin_shufflevector(rows[0], rows[1], 0, 4, 1, 5);
  const Row<T> ab_zw = __builtin_shufflevector(rows[0], rows[1], 2, 6, 3, 7);
  const Row<T> cd_xy = __builtin_shufflevector(rows[2], rows[3], 0, 4, 1, 5);
  const Row<T> cd_zw = __builtin_shufflevector(rows[2], rows[3], 2, 6, 3, 7);
  rows[0] = __builtin_shufflevector(ab_xy, cd_xy, 0, 1, 4, 5);
  rows[1] = __builtin_shufflevector(ab_xy, cd_xy, 2, 3, 6, 7);
  rows[2] = __builtin_shufflevector(ab_zw, cd_zw, 0, 1, 4, 5);
  rows[3] = __builtin_shufflevector(ab_zw, cd_zw, 2, 3, 6, 7);
}

/// Loads the vertices of four triangles from the i-th on, turning rows of vertices into the
/// batch's.
template <typename T>
TT3D_HD void load_four(const T* clip, const int32_t* faces, int i, Batch<T>& batch) {
  for (int k = 0; k < 3; ++k) {
    Row<T> rows[4];
    for (int j = 0; j < 4; ++j) {
      const int32_t vertex = faces[3 * static_cast<int64_t>(batch.of[i + j].face) + k];
      rows[j] = load<Row<T>>(clip + 4 * static_cast<int64_t>(vertex));
    }
    transpose<T>(rows);
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
  /// A row of a block: the values of the edges' functions, and the depth.
  struct Values {
    Lanes e[3];
    Lanes zw;
  };
  static constexpr Mask kPlace = {0, 1, 2, 3};

  Band<T>& band;

  TT3D_HD static bool any(const Mask& mask) {
    const auto either = __builtin_shufflevector(mask, mask, 0, 1) |
                        __builtin_shufflevector(mask, mask, 2, 3);
    return (either[0] | either[1]) != 0;
  }

  /// Writes the lanes of a mask.
  template <typename Number>
  TT3D_HD static void put(const Row<Number>& value, const Row<WholeAs<Number>>& mask, Number* to) {
    typedef Row<WholeAs<Number>> Bits;
    const Bits row = (mask & reinterpret_cast<const Bits&>(value)) | (~mask & load<Bits>(to));
    std::memcpy(to, &row, sizeof row);
  }

  /// Takes from the lanes that a row hits those where an edge function is 0 and which lie outside,
  /// and those at the depth of what is shown, unless the triangle's index is lower.
  TT3D_HD static void settle_ties(const TriangleSetup& t, T number, const Values& at,
                                  const Group<T>& group, Mask& hit) {
    for (int i = 0; i < kColumns; ++i) {
      const double e[3] = {at.e[0][i], at.e[1][i], at.e[2][i]};
      const bool behind = at.zw[i] == group.depth[i] && number > group.shown[i];
      if (behind || !inside(t, e)) hit[i] = 0;
    }
  }

  /// Draws a triangle in a block, whose first row is `group`.
  TT3D_HD void draw_block(const TriangleSetup& t, T number, const Values (&at)[kRows],
                          Group<T>* group) const {
    Mask hit[kRows], some = {}, tied = {};
    for (int r = 0; r < kRows; ++r) {
      const auto shown = load<Lanes>(group[r * band.stride].depth);
      const Lanes smallest = least(at[r].e[0], at[r].e[1], at[r].e[2]);
      hit[r] = (smallest >= 0) & (at[r].zw >= -1) & (at[r].zw <= shown);
      some |= hit[r];
      tied |= hit[r] & ((smallest == 0) | (at[r].zw == shown));
    }
    if (!any(some)) return;
    if (__builtin_expect(any(tied), 0)) {
      for (int r = 0; r < kRows; ++r) {
        settle_ties(t, number, at[r], group[r * band.stride], hit[r]);
      }
    }
    for (int r = 0; r < kRows; ++r) put_row(number, at[r], hit[r], group[r * band.stride]);
  }

  TT3D_HD static void put_row(T number, const Values& at, const Mask& hit, Group<T>& group) {
    const Lanes scale = 1 / (at.e[0] + at.e[1] + at.e[2]);
    const auto lanes = __builtin_convertvector(hit, Row<WholeAs<T>>);
    put(at.zw, hit, group.depth);
    put(__builtin_convertvector(at.e[0] * scale, Row<T>), lanes, group.u);
    put(__builtin_convertvector(at.e[1] * scale, Row<T>), lanes, group.v);
    put(Row<T>{} + number, lanes, group.shown);
  }

  /// Of four columns or rows from `begin` on, the depth function's part of those in [first,last),
  /// infinity of others.
  TT3D_HD static Lanes within(const Lanes& part, int begin, int first, int last) {
    const Mask place = kPlace + begin;
    return (place >= first) & (place < last) ? part : Lanes{} + kInfinity;
  }
  TT3D_HD Lanes depth_of_columns(const TriangleSetup& t, int x) const {
    return within(t.depth.of_column(load<Lanes>(band.px.data() + x)), x, t.x_begin, t.x_end);
  }
  TT3D_HD Lanes depth_of_rows(const TriangleSetup& t, int y) const {
    return within(t.depth.of_row(load<Lanes>(band.py.data() + y - band.y_begin)), y, t.y_begin,
                  t.y_end);
  }
  TT3D_HD Group<T>* group_at(int x, int y) const {
    return band.groups.data() + (y - band.y_begin) * band.stride + x / kColumns;
  }

  /// Whether all that a triangle may cover lies behind what is shown.
  TT3D_HD bool is_hidden(const TriangleSetup& t) const {
    constexpr int kAtOnce = 2;  // groups: nearly always all
    for (int x = t.x_begin / kColumns * kColumns; x < t.x_end; x += kAtOnce * kColumns) {
      for (int y = t.y_begin; y < t.y_end; y += kColumns) {
        const Group<T>* group = group_at(x, y);
        const Lanes row = depth_of_rows(t, y);
        Mask some = {};
        for (int i = 0; i < kAtOnce; ++i) {
          const Lanes column = depth_of_columns(t, x + i * kColumns);
          for (int r = 0; r < kColumns; ++r) {
            some |= column + row[r] <= load<Lanes>(group[r * band.stride + i].depth);
          }
        }
        if (any(some)) return false;
      }
    }
    return true;
  }

  /// Outside the triangle's bounds the depth is infinite: nothing is drawn there. Blocks begin at
  /// whole groups: what one triangle writes, its neighbour reads next, and processors pass that on
  /// at once only where both are the same bytes.
  TT3D_HD void draw_triangle(const TriangleSetup& t, T number) const {
    for (int x = t.x_begin / kColumns * kColumns; x < t.x_end; x += kColumns) {
      const Lanes zw_of_column = depth_of_columns(t, x);
      const auto px = load<Lanes>(band.px.data() + x);
      for (int y = t.y_begin; y < t.y_end; y += kRows) {
        const Lanes zw_of_row = depth_of_rows(t, y);
        const auto py = load<Lanes>(band.py.data() + y - band.y_begin);
        Values at[kRows];
        for (int r = 0; r < kRows; ++r) at[r].zw = zw_of_column + zw_of_row[r];
        for (int k = 0; k < 3; ++k) {
          const Lanes column = t.edge[k].of_column(px), row = t.edge[k].of_row(py);
          for (int r = 0; r < kRows; ++r) at[r].e[k] = column + row[r];
        }
        draw_block(t, number, at, group_at(x, y));
      }
    }
  }

  /// far: nearer triangles hide most of these, so that depths are tested before edges.
  TT3D_HD void draw_batch(const Batch<T>& batch, bool far) const {
    for (int i = 0; i < batch.count; ++i) {
      if (!batch.drawn[i]) continue;
      const TriangleSetup t = batch.setup(i);
      if (!far || !is_hidden(t)) draw_triangle(t, static_cast<T>(batch.of[i].face + 1));
    }
  }
};

/// All triangles of a view, the near half before the far half, which it mostly hides. Within a half
/// in order: neighbours in a mesh are neighbours on the screen, so the band stays in the cache
/// without sorting triangles into tiles first.
template <typename T>
TT3D_HD void draw_band(const T* clip, const int32_t* faces, const VertexBounds* points,
                       const Sizes& s, Band<T>& band) {
  const Painter<T> painter = {band};
  Batch<T> batch;
  for (int64_t f = 0; f < s.faces;) {
    f = choose(faces, points, s, band, f, batch);
    set_up(clip, faces, batch);
    painter.draw_batch(batch, false);
  }
  for (int64_t i = 0; i < band.far_count;) {
    i = choose_far(band, i, batch);
    set_up(clip, faces, batch);
    painter.draw_batch(batch, true);
  }
}

/// Turns a band's groups into rows of pixels.
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

/// A depth amid a view's vertices, from some of them. It tells which triangles are drawn first, not
/// what they show.
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

/// Rows [y_begin,y_end) of a view, whose pixels start at `rast`. points: of its vertices.
template <typename T>
void draw_rows(const T* clip, const int32_t* faces, const VertexBounds* points, T* rast,
               int64_t y_begin, int64_t y_end, const Sizes& s) {
  Band<T> band(s, y_begin, y_end, middle_depth(points, s.vertices));
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
