#include <cuda_runtime.h>

#include "raster_kernels.h"
#include "tt3d/cuda.h"

// Triangles are binned to tiles; then a block draws a tile, a thread a pixel, the tile's triangles
// passing through shared memory in batches. A list's order is the hardware's, the picture is not:
// `hides` takes the nearest and at equal depth the lower index, whatever comes first.
namespace tt3d::raster {
namespace {

constexpr int kTile = 16;
constexpr int kPixels = kTile * kTile;
constexpr int kBatch = 64;
constexpr int kWarp = 32;

struct Tiles {
  int64_t x, y;  ///< of a view
  explicit Tiles(const Sizes& s)
      : x((s.width + kTile - 1) / kTile), y((s.height + kTile - 1) / kTile) {}
};

/// Calls visit(tile) for the tiles that triangle i (of all views) can touch, a warp a triangle: its
/// lanes take every 32nd tile, so that one that fills the picture is not one thread's work.
template <typename T, typename Visit>
__device__ void visit_tiles(const T* clip, const int32_t* faces, const Sizes& s, const Tiles& tiles,
                            int64_t i, int lane, const Visit& visit) {
  const int64_t view = i / s.faces;
  TriangleSetup t;
  if (!setup_triangle(clip + view * s.vertices * 4, faces + 3 * (i % s.faces), s.height, s.width,
                      t)) {
    return;
  }
  const int x0 = t.x_begin / kTile, y0 = t.y_begin / kTile;
  const int columns = (t.x_end - 1) / kTile + 1 - x0, rows = (t.y_end - 1) / kTile + 1 - y0;
  for (int k = lane; k < columns * rows; k += kWarp) {
    visit((view * tiles.y + y0 + k / columns) * tiles.x + x0 + k % columns);
  }
}

template <typename T>
struct CountTiles {
  const T* clip;
  const int32_t* faces;
  int64_t* counts;
  Sizes s;
  Tiles tiles;
  __device__ void operator()(int64_t thread) const {
    visit_tiles(clip, faces, s, tiles, thread / kWarp, static_cast<int>(thread % kWarp),
                [&](int64_t tile) { (void)take_place(counts + tile + 1); });
  }
};

template <typename T>
struct FillLists {
  const T* clip;
  const int32_t* faces;
  int64_t* next;
  int32_t* list;
  Sizes s;
  Tiles tiles;
  __device__ void operator()(int64_t thread) const {
    const int64_t i = thread / kWarp;
    visit_tiles(clip, faces, s, tiles, i, static_cast<int>(thread % kWarp), [&](int64_t tile) {
      list[take_place(next + tile)] = static_cast<int32_t>(i % s.faces);
    });
  }
};

/// What a pixel shows so far.
struct Shown {
  double u = 0, v = 0, depth = INFINITY;
  int32_t face = -1;
};

/// Tests the pixel against the batch.
__device__ void draw_batch(const TriangleSetup* setups, const int32_t* ids, int count,
                           int64_t column, int64_t row, const Sizes& s, Shown& shown) {
  const double px = pixel_x(column, s.width), py = pixel_y(row, s.height);
  for (int k = 0; k < count; ++k) {
    const TriangleSetup& t = setups[k];
    if (column < t.x_begin || column >= t.x_end || row < t.y_begin || row >= t.y_end) continue;
    Hit hit;
    if (!hit_triangle(t, px, py, hit)) continue;
    if (hides(hit.zw, ids[k], shown.depth, shown.face)) {
      const double scale = hit.scale();
      shown = {hit.e[0] * scale, hit.e[1] * scale, hit.zw, ids[k]};
    }
  }
}

template <typename T>
__global__ void __launch_bounds__(kPixels)
    draw_kernel(const T* clip, const int32_t* faces, const int64_t* begin, const int32_t* list,
                T* rast, Sizes s, Tiles tiles) {
  __shared__ TriangleSetup setups[kBatch];
  __shared__ int32_t ids[kBatch];
  const int64_t tile = blockIdx.x;
  const int64_t view = tile / (tiles.x * tiles.y), place = tile % (tiles.x * tiles.y);
  const int thread = static_cast<int>(threadIdx.x);
  const int64_t column = place % tiles.x * kTile + thread % kTile;
  const int64_t row = place / tiles.x * kTile + thread / kTile;
  Shown shown;
  for (int64_t first = begin[tile]; first < begin[tile + 1]; first += kBatch) {
    const int64_t left = begin[tile + 1] - first;
    const int count = left < kBatch ? static_cast<int>(left) : kBatch;
    __syncthreads();  // the batch before is done with
    if (thread < count) {
      const int32_t face = list[first + thread];
      ids[thread] = face;
      // A listed triangle was set up before: this succeeds again.
      (void)setup_triangle(clip + view * s.vertices * 4, faces + 3 * static_cast<int64_t>(face),
                           s.height, s.width, setups[thread]);
    }
    __syncthreads();
    draw_batch(setups, ids, count, column, row, s, shown);
  }
  if (column >= s.width || row >= s.height) return;
  T* out = rast + 4 * ((view * s.height + row) * s.width + column);
  const bool hit = shown.face >= 0;
  out[0] = static_cast<T>(shown.u);
  out[1] = static_cast<T>(shown.v);
  out[2] = static_cast<T>(hit ? shown.depth : 0.0);
  out[3] = static_cast<T>(shown.face + 1);
}

}  // namespace

int64_t tile_count(const Sizes& s) {
  const Tiles tiles(s);
  return s.views * tiles.x * tiles.y;
}

template <typename T>
void count_tile_faces(const Cuda& on, const T* clip, const int32_t* faces, int64_t* counts,
                      const Sizes& s) {
  const CountTiles<T> body = {clip, faces, counts, s, Tiles(s)};
  for_each_index(on, s.views * s.faces * kWarp, body);
}

template <typename T>
void fill_tile_lists(const Cuda& on, const T* clip, const int32_t* faces, int64_t* next,
                     int32_t* list, const Sizes& s) {
  const FillLists<T> body = {clip, faces, next, list, s, Tiles(s)};
  for_each_index(on, s.views * s.faces * kWarp, body);
}

template <typename T>
void draw_tiles(const Cuda& on, const T* clip, const int32_t* faces, const int64_t* begin,
                const int32_t* list, T* rast, const Sizes& s) {
  const int64_t tiles = tile_count(s);
  if (tiles == 0) return;
  draw_kernel<<<static_cast<unsigned>(tiles), kPixels, 0, stream_of(on)>>>(clip, faces, begin, list,
                                                                           rast, s, Tiles(s));
  TT3D_CUDA_CHECK(cudaGetLastError());
}

#define TT3D_INSTANTIATE(T)                                                                       \
  template void count_tile_faces(const Cuda&, const T*, const int32_t*, int64_t*, const Sizes&);  \
  template void fill_tile_lists(const Cuda&, const T*, const int32_t*, int64_t*, int32_t*,        \
                                const Sizes&);                                                    \
  template void draw_tiles(const Cuda&, const T*, const int32_t*, const int64_t*, const int32_t*, \
                           T*, const Sizes&);
TT3D_INSTANTIATE(float)
TT3D_INSTANTIATE(double)
#undef TT3D_INSTANTIATE

}  // namespace tt3d::raster
