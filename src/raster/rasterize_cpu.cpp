#include <algorithm>
#include <limits>
#include <vector>

#include "raster_kernels.h"
#include "tt3d/device.h"

// Compiled with -ffp-contract=off: both triangles at an edge must see the same bits.
namespace tt3d::raster {
namespace {

constexpr int kTile = 32;

/// Triangles by the tiles they can touch, each tile's list in face order.
struct TileLists {
  std::vector<int64_t> begin;  ///< [tiles + 1]
  std::vector<int32_t> faces;
};

struct TileRange {
  int x_begin, x_end, y_begin, y_end;
};

TileRange tiles_of(const TriangleSetup& t) {
  return {t.x_begin / kTile, (t.x_end - 1) / kTile + 1, t.y_begin / kTile,
          (t.y_end - 1) / kTile + 1};
}

template <typename T>
TileLists bin_triangles(const T* clip, const int32_t* faces, const Sizes& s, int64_t tiles_x,
                        int64_t tiles_y) {
  TileLists lists;
  lists.begin.assign(tiles_x * tiles_y + 1, 0);
  std::vector<TileRange> ranges(s.faces, TileRange{0, 0, 0, 0});
  const auto for_tiles = [&](const TileRange& r, const auto& visit) {
    for (int y = r.y_begin; y < r.y_end; ++y) {
      for (int x = r.x_begin; x < r.x_end; ++x) visit(y * tiles_x + x);
    }
  };
  // Count, prefix-sum, fill.
  for (int64_t f = 0; f < s.faces; ++f) {
    TriangleSetup setup;
    if (!setup_triangle(clip, faces + 3 * f, s.height, s.width, setup)) continue;
    ranges[f] = tiles_of(setup);
    for_tiles(ranges[f], [&](int64_t tile) { ++lists.begin[tile + 1]; });
  }
  for (size_t i = 1; i < lists.begin.size(); ++i) lists.begin[i] += lists.begin[i - 1];
  lists.faces.resize(lists.begin.back());
  std::vector<int64_t> next(lists.begin.begin(), lists.begin.end() - 1);
  for (int64_t f = 0; f < s.faces; ++f) {
    for_tiles(ranges[f],
              [&](int64_t tile) { lists.faces[next[tile]++] = static_cast<int32_t>(f); });
  }
  return lists;
}

/// One row of one triangle inside a tile.
template <typename T>
void draw_row(const TriangleSetup& t, int64_t row, int x_begin, int x_end, int64_t face,
              const Sizes& s, T* rast_row, double* depth_row) {
  const double py = pixel_y(row, s.height);
  for (int x = x_begin; x < x_end; ++x) {
    Hit hit;
    if (!hit_triangle(t, pixel_x(x, s.width), py, hit)) continue;
    double& depth = depth_row[x % kTile];
    if (hit.zw >= depth) continue;
    depth = hit.zw;
    T* out = rast_row + 4 * x;
    out[0] = static_cast<T>(hit.u);
    out[1] = static_cast<T>(hit.v);
    out[2] = static_cast<T>(hit.zw);
    out[3] = static_cast<T>(face + 1);
  }
}

template <typename T>
void draw_tile(const T* clip, const int32_t* faces, const TileLists& lists, int64_t tile,
               int64_t tiles_x, const Sizes& s, T* rast) {
  const auto x0 = static_cast<int>(tile % tiles_x) * kTile;
  const auto y0 = static_cast<int>(tile / tiles_x) * kTile;
  double depth[kTile * kTile];
  std::fill_n(depth, kTile * kTile, std::numeric_limits<double>::infinity());
  for (int64_t i = lists.begin[tile]; i < lists.begin[tile + 1]; ++i) {
    const int64_t face = lists.faces[i];
    TriangleSetup setup;
    if (!setup_triangle(clip, faces + 3 * face, s.height, s.width, setup)) continue;
    const int x_begin = std::max(setup.x_begin, x0), x_end = std::min(setup.x_end, x0 + kTile);
    const int y_begin = std::max(setup.y_begin, y0), y_end = std::min(setup.y_end, y0 + kTile);
    for (int y = y_begin; y < y_end; ++y) {
      draw_row(setup, y, x_begin, x_end, face, s, rast + 4 * y * s.width,
               depth + (y % kTile) * kTile);
    }
  }
}

}  // namespace

template <typename T>
void rasterize(const Cpu&, const T* clip, const int32_t* faces, T* rast, const Sizes& s) {
  const int64_t tiles_x = (s.width + kTile - 1) / kTile;
  const int64_t tiles_y = (s.height + kTile - 1) / kTile;
  const int64_t tiles = tiles_x * tiles_y;
  std::vector<TileLists> lists(s.views);
  at::parallel_for(0, s.views, 1, [&](int64_t first, int64_t last) {
    for (int64_t n = first; n < last; ++n) {
      lists[n] = bin_triangles(clip + n * s.vertices * 4, faces, s, tiles_x, tiles_y);
    }
  });
  at::parallel_for(0, s.views * tiles, 1, [&](int64_t first, int64_t last) {
    for (int64_t i = first; i < last; ++i) {
      const int64_t n = i / tiles;
      draw_tile(clip + n * s.vertices * 4, faces, lists[n], i % tiles, tiles_x, s,
                rast + n * s.height * s.width * 4);
    }
  });
}

template <typename T>
void scatter(const Cpu&, const RasterizeBackwardPixel<T>& body) {
  const int64_t pixels = body.s.height * body.s.width;
  at::parallel_for(0, body.s.views, 1, [&](int64_t first, int64_t last) {
    for (int64_t i = first * pixels; i < last * pixels; ++i) body(i);
  });
}

template void rasterize(const Cpu&, const float*, const int32_t*, float*, const Sizes&);
template void rasterize(const Cpu&, const double*, const int32_t*, double*, const Sizes&);
template void scatter(const Cpu&, const RasterizeBackwardPixel<float>&);
template void scatter(const Cpu&, const RasterizeBackwardPixel<double>&);

}  // namespace tt3d::raster
