#include <cuda_runtime.h>

#include "raster_kernels.h"
#include "tt3d/cuda.h"

// The GPU draws triangles in any order and still gives the CPU's result. A pixel's depth is the
// minimum over all triangles that cover it, its triangle the lowest index at that depth, and a
// minimum does not depend on the order. One thread draws a small triangle, one warp a large one,
// many warps one that fills the picture.
namespace tt3d::raster {
namespace {

constexpr int kWarp = 32;
constexpr int kBlock = 256;
/// Largest bounds, in pixels, of a small triangle and of a triangle for one warp.
constexpr int64_t kSmall = 256, kLarge = 1 << 14;
constexpr int64_t kSlices = 64;  ///< warps that share a triangle larger than kLarge
/// Blocks that share the large triangles. Only the GPU knows how many of these there are.
constexpr int kLargeBlocks = 1024;

/// Maps a depth in [-1,1] to an unsigned integer of the same order. (Adding 0.0 turns -0 into 0.)
__device__ uint64_t key_of(double depth) {
  const auto bits = static_cast<uint64_t>(__double_as_longlong(depth + 0.0));
  return bits >> 63 ? ~bits : bits | uint64_t{1} << 63;
}

__device__ void put_least(uint64_t* value, uint64_t candidate) {
  static_assert(sizeof(unsigned long long) == sizeof(uint64_t));
  if (candidate >= *value) return;  // the value only decreases
  atomicMin(reinterpret_cast<unsigned long long*>(value), candidate);
}

/// The triangles of all views.
template <typename T>
struct Triangles {
  const T* clip;
  const int32_t* faces;
  DepthBuffer buffer;
  Sizes s;

  __device__ bool setup(int64_t i, TriangleSetup& t) const {
    return setup_triangle(clip + i / s.faces * s.vertices * 4, faces + 3 * (i % s.faces), s.height,
                          s.width, t);
  }

  /// Calls pass(pixel of all views, depth) for pixels that triangle i covers: every `stride`-th
  /// pixel of its bounds, from `first` up to (not including) `last`.
  template <typename Pass>
  __device__ void visit(int64_t i, const TriangleSetup& t, int64_t first, int64_t last,
                        int64_t stride, const Pass& pass) const {
    const int64_t corner = i / s.faces * s.height * s.width;
    const auto width = static_cast<unsigned>(t.x_end - t.x_begin);
    for (int64_t k = first; k < last; k += stride) {
      const unsigned down = static_cast<unsigned>(k) / width;
      const int64_t row = t.y_begin + down;
      const int64_t column = t.x_begin + (static_cast<unsigned>(k) - down * width);
      Hit hit;
      if (!hit_triangle(t, pixel_x(column, s.width), pixel_y(row, s.height), hit)) continue;
      pass(corner + row * s.width + column, hit.zw);
    }
  }
};

__device__ int64_t pixels_of(const TriangleSetup& t) {
  return static_cast<int64_t>(t.x_end - t.x_begin) * (t.y_end - t.y_begin);
}

/// First pass: the minimum depth of each pixel.
template <typename T>
struct DepthPass {
  DepthBuffer buffer;
  static constexpr bool kFirst = true;
  __device__ DepthPass(const Triangles<T>& all, int64_t /*triangle*/) : buffer(all.buffer) {}
  __device__ void operator()(int64_t pixel, double depth) const {
    put_least(buffer.depth + pixel, key_of(depth));
  }
};

/// Second pass: the lowest triangle index at that depth.
template <typename T>
struct FacePass {
  DepthBuffer buffer;
  uint32_t face;
  static constexpr bool kFirst = false;
  __device__ FacePass(const Triangles<T>& all, int64_t triangle)
      : buffer(all.buffer), face(static_cast<uint32_t>(triangle % all.s.faces)) {}
  __device__ void operator()(int64_t pixel, double depth) const {
    if (key_of(depth) == buffer.depth[pixel]) atomicMin(buffer.face + pixel, face);
  }
};

/// Draws small triangles. The first pass also lists the others: triangles for one warp at the front
/// of the list, larger ones at the back.
template <typename T, typename Pass>
struct SmallTriangle {
  Triangles<T> all;
  __device__ void operator()(int64_t i) const {
    TriangleSetup t;
    if (!all.setup(i, t)) return;
    const int64_t pixels = pixels_of(t);
    if (pixels <= kSmall) {
      all.visit(i, t, 0, pixels, 1, Pass(all, i));
    } else if (Pass::kFirst) {
      const bool large = pixels <= kLarge;
      const int64_t place = take_place(all.buffer.listed + (large ? 0 : 1));
      const int64_t count = all.s.views * all.s.faces;
      all.buffer.list[large ? place : count - 1 - place] = static_cast<int32_t>(i);
    }
  }
};

/// Draws the listed triangles, one warp per triangle or per slice of it.
template <typename T, typename Pass>
__global__ void __launch_bounds__(kBlock) large_kernel(Triangles<T> all) {
  const int64_t warp = (static_cast<int64_t>(blockIdx.x) * kBlock + threadIdx.x) / kWarp;
  const int64_t warps = static_cast<int64_t>(gridDim.x) * kBlock / kWarp;
  const int lane = static_cast<int>(threadIdx.x) % kWarp;
  const int64_t large = all.buffer.listed[0], larger = all.buffer.listed[1];
  for (int64_t work = warp; work < large + larger * kSlices; work += warps) {
    const int64_t slice = work < large ? 0 : (work - large) % kSlices;
    const int64_t place =
        work < large ? work : all.s.views * all.s.faces - 1 - (work - large) / kSlices;
    const int64_t i = all.buffer.list[place];
    TriangleSetup t;
    if (!all.setup(i, t)) continue;  // never: it succeeded before the triangle was listed
    const int64_t pixels = pixels_of(t), slices = work < large ? 1 : kSlices;
    all.visit(i, t, slice * pixels / slices + lane, (slice + 1) * pixels / slices, kWarp,
              Pass(all, i));
  }
}

/// Writes a pixel of rast, once its triangle is known.
template <typename T>
struct ShownPixel {
  Triangles<T> all;
  T* rast;
  __device__ void operator()(int64_t i) const {
    T* out = rast + 4 * i;
    const uint32_t face = all.buffer.face[i];
    const PixelPlace at = place_of(i, all.s);
    TriangleSetup t;
    Hit hit = {};
    if (face == UINT32_MAX || !all.setup(at.view * all.s.faces + face, t) ||
        !hit_triangle(t, pixel_x(at.column, all.s.width), pixel_y(at.row, all.s.height), hit)) {
      for (int k = 0; k < 4; ++k) out[k] = 0;
      return;
    }
    const double scale = hit.scale();
    out[0] = static_cast<T>(hit.e[0] * scale);
    out[1] = static_cast<T>(hit.e[1] * scale);
    out[2] = static_cast<T>(hit.zw);
    out[3] = static_cast<T>(face + 1);
  }
};

template <typename T, template <typename> typename Pass>
void draw(const Cuda& on, const Triangles<T>& all) {
  for_each_index(on, all.s.views * all.s.faces, SmallTriangle<T, Pass<T>>{all});
  large_kernel<T, Pass<T>><<<kLargeBlocks, kBlock, 0, stream_of(on)>>>(all);
  TT3D_CUDA_CHECK(cudaGetLastError());
}

// ---- Gradients: pixels that show the same triangle are summed first -----------------------------

/// A run: adjacent lanes of a warp with the same key.
struct Run {
  int lane, last;  ///< last: the run's last lane
  bool first;      ///< this lane is the run's first

  __device__ explicit Run(int64_t key) : lane(static_cast<int>(threadIdx.x) % kWarp) {
    const int64_t before = __shfl_up_sync(~0U, key, 1);
    first = lane == 0 || key != before;
    const unsigned begins = __ballot_sync(~0U, first);
    const unsigned later = lane == kWarp - 1 ? 0 : begins >> (lane + 1);
    last = later == 0 ? kWarp - 1 : lane + __ffs(static_cast<int>(later)) - 1;
  }
  /// The run's sum; valid in its first lane.
  template <typename T>
  __device__ T sum(T value) const {
    for (int step = 1; step < kWarp; step *= 2) {
      const T other = __shfl_down_sync(~0U, value, step);
      if (lane + step <= last) value += other;
    }
    return value;
  }
};

template <typename T>
__device__ void spread_run(const RasterizeBackwardPixel<T>& body, int64_t i, bool inside) {
  const int64_t face = inside ? body.face_at(i) : -1;
  if (__ballot_sync(~0U, face >= 0) == 0) return;
  const PixelPlace at = place_of(i, body.s);
  const int64_t vertex = at.view * body.s.vertices * 4;
  const int32_t* triangle = body.faces + 3 * (face < 0 ? 0 : face);
  FlatVertex<double> step = {};
  double weight[3] = {};
  if (face >= 0) {
    FlatVertex<double> corner[3];
    load_flat_triangle(body.clip + vertex, triangle, corner);
    step = rasterize_backward(
        corner, pixel_x(at.column, body.s.width), pixel_y(at.row, body.s.height),
        static_cast<double>(body.grad_rast[4 * i]), static_cast<double>(body.grad_rast[4 * i + 1]));
    weight[0] = static_cast<double>(body.rast[4 * i]);
    weight[1] = static_cast<double>(body.rast[4 * i + 1]);
    weight[2] = 1 - weight[0] - weight[1];
  }
  const Run run(face < 0 ? -1 : at.view * body.s.faces + face);
  for (int k = 0; k < 3; ++k) {
    const T x = run.sum(static_cast<T>(weight[k] * step.x));
    const T y = run.sum(static_cast<T>(weight[k] * step.y));
    const T w = run.sum(static_cast<T>(weight[k] * step.w));
    if (face < 0 || !run.first) continue;
    T* to = body.grad_clip + vertex + 4 * static_cast<int64_t>(triangle[k]);
    accumulate(to, x);
    accumulate(to + 1, y);
    accumulate(to + 3, w);  // gradients of z are 0
  }
}

template <typename T>
__device__ void spread_run(const InterpolateBackwardPixel<T>& body, int64_t i, bool inside) {
  const int64_t face = inside ? body.face_at(i) : -1;
  if (inside && body.grad_rast) body.set_grad_rast(i, face, body.s.channels);
  if (!body.grad_attributes || __ballot_sync(~0U, face >= 0) == 0) return;
  const Run run(face);
  for (int corner = 0; corner < 3; ++corner) {
    const T weight = face < 0 ? T{0} : body.weight(i, corner);
    for (int64_t k = 0; k < body.s.channels; ++k) {
      const T share = face < 0 ? T{0} : weight * body.grad_out[i * body.s.channels + k];
      const T sum = run.sum(share);
      if (face < 0 || !run.first) continue;
      accumulate(body.grad_attributes + body.faces[3 * face + corner] * body.s.channels + k, sum);
    }
  }
}

/// Whole warps take every iteration together; `inside` marks the lanes that have a pixel.
template <typename Body>
__global__ void __launch_bounds__(kBlock) run_kernel(int64_t pixels, Body body) {
  const int64_t stride = static_cast<int64_t>(gridDim.x) * kBlock;
  const int64_t lane = threadIdx.x % kWarp;
  for (int64_t i = static_cast<int64_t>(blockIdx.x) * kBlock + threadIdx.x; i - lane < pixels;
       i += stride) {
    spread_run(body, i, i < pixels);
  }
}

template <typename Body>
void scatter_runs(const Cuda& on, const Body& body) {
  const int64_t pixels = body.s.pixels();
  if (pixels <= 0) return;
  const int64_t blocks = std::min<int64_t>((pixels + kBlock - 1) / kBlock, 1 << 20);
  run_kernel<<<static_cast<unsigned>(blocks), kBlock, 0, stream_of(on)>>>(pixels, body);
  TT3D_CUDA_CHECK(cudaGetLastError());
}

}  // namespace

template <typename T>
void rasterize(const Cuda& on, const T* clip, const int32_t* faces, const DepthBuffer& buffer,
               T* rast, const Sizes& s) {
  const Triangles<T> all = {clip, faces, buffer, s};
  if (s.views * s.faces > 0) {
    draw<T, DepthPass>(on, all);
    draw<T, FacePass>(on, all);
  }
  for_each_index(on, s.pixels(), ShownPixel<T>{all, rast});
}

template <typename T>
void scatter(const Cuda& on, const RasterizeBackwardPixel<T>& body) {
  scatter_runs(on, body);
}

template <typename T>
void scatter(const Cuda& on, const InterpolateBackwardPixel<T>& body) {
  scatter_runs(on, body);
}

#define TT3D_INSTANTIATE(T)                                                              \
  template void rasterize(const Cuda&, const T*, const int32_t*, const DepthBuffer&, T*, \
                          const Sizes&);                                                 \
  template void scatter(const Cuda&, const RasterizeBackwardPixel<T>&);                  \
  template void scatter(const Cuda&, const InterpolateBackwardPixel<T>&);
TT3D_INSTANTIATE(float)
TT3D_INSTANTIATE(double)
#undef TT3D_INSTANTIATE

}  // namespace tt3d::raster
