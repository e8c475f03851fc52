// Our kernels compared with plain tensor operations, forward and backward.
//
// Meshes come from files, so that other programs (bench/peers.py) draw exactly the same triangles:
//   TT3D_BENCH_MESH  safetensors with clip [1,V,4] f32, faces [F,3] i32, colors [V,3] f32,
//                    uvs [V,2] f32
#include <ATen/Parallel.h>
#include <ATen/core/grad_mode.h>
#include <benchmark/benchmark.h>

#include <cmath>
#include <cstdlib>

#include "field/field_reference.h"
#include "raster/raster_reference.h"
#include "tt3d/core.h"
#include "tt3d/field.h"
#include "tt3d/kernel.h"
#include "tt3d/raster.h"
#include "tt3d/tensor_file.h"

namespace tt3d {
namespace {

using at::Tensor;

struct Scene {
  Tensor clip, faces, colors, uvs;
};

/// The mesh named by the environment; throws InputError if it is not set.
Scene load_scene() {
  const char* path = std::getenv("TT3D_BENCH_MESH");
  if (path == nullptr) throw InputError("TT3D_BENCH_MESH is not set: run scripts/bench");
  const TensorFile file = load_tensors(path);
  return {file.get("clip", {1, -1, 4}, at::kFloat), file.get("faces", {-1, 3}, at::kInt),
          file.get("colors", {-1, 3}, at::kFloat), file.get("uvs", {-1, 2}, at::kFloat)};
}

Tensor leaf(const Tensor& t) { return t.detach().clone().requires_grad_(true); }

/// Rasterize, interpolate colours, antialias; gradients to positions and colours.
void colored_mesh(benchmark::State& state) {
  const Scene scene = load_scene();
  const Tensor clip = leaf(scene.clip), colors = leaf(scene.colors);
  const Tensor twins = raster::edge_twins(scene.faces);
  for (auto _ : state) {
    const Tensor rast = raster::rasterize(clip, scene.faces, 400, 400);
    const Tensor colored = raster::interpolate(colors, rast, scene.faces);
    const Tensor picture = raster::antialias(colored, rast, clip, scene.faces, twins);
    picture.backward(2 * picture.detach());  // of the sum of squares, like DEODR in peers.py
    clip.mutable_grad().reset();
    colors.mutable_grad().reset();
  }
}
BENCHMARK(colored_mesh)->Unit(benchmark::kMillisecond)->UseRealTime();

/// Rasterize, interpolate UVs, look up the texture; gradient with respect to the texture only.
void textured_mesh(benchmark::State& state) {
  const Scene scene = load_scene();
  const Tensor texels = leaf(at::rand({512, 512, 3}));
  for (auto _ : state) {
    const Tensor rast = raster::rasterize(scene.clip, scene.faces, 400, 400);
    const Tensor uv = raster::interpolate(scene.uvs, rast, scene.faces);
    const Tensor slopes = raster::attribute_derivatives(scene.uvs, rast, scene.clip, scene.faces);
    raster::texture(texels, uv, slopes, rast).square().sum().backward();
    texels.mutable_grad().reset();
  }
}
BENCHMARK(textured_mesh)->Unit(benchmark::kMillisecond)->UseRealTime();

// ---- Growth: the same at other sizes ----------------------------------------------------------

/// A wavy sheet of 2 n^2 triangles in front of the camera, [1,V,4] and [F,3].
std::pair<Tensor, Tensor> sheet(int64_t n) {
  const Tensor line = at::linspace(-0.9, 0.9, n + 1);
  const Tensor x = line.repeat({n + 1}), y = line.repeat_interleave(n + 1);
  const Tensor z = 0.2 * (4 * x).sin() * (3 * y).cos();
  const Tensor w = 2 + z;
  const Tensor clip = at::stack({x * w, y * w, z * w, w}, 1).unsqueeze(0).to(at::kFloat);
  const Tensor corner = (at::arange(n).unsqueeze(1) * (n + 1) + at::arange(n)).flatten();
  const Tensor first = at::stack({corner, corner + 1, corner + n + 2}, 1);
  const Tensor second = at::stack({corner, corner + n + 2, corner + n + 1}, 1);
  return {clip, at::cat({first, second}).to(at::kInt).contiguous()};
}

/// A sheet of 2 side^2 triangles in a picture of size x size: rasterized, coloured and antialiased,
/// with gradients.
void sheet_step(benchmark::State& state, int64_t side, int64_t size) {
  const auto [clip_of_sheet, faces] = sheet(side);
  const Tensor clip = leaf(clip_of_sheet), colors = leaf(at::rand({clip.size(1), 3}));
  const Tensor twins = raster::edge_twins(faces);
  for (auto _ : state) {
    const Tensor rast = raster::rasterize(clip, faces, size, size);
    const Tensor picture = raster::interpolate(colors, rast, faces);
    raster::antialias(picture, rast, clip, faces, twins).square().sum().backward();
    clip.mutable_grad().reset();
    colors.mutable_grad().reset();
  }
}
void growth_pixels(benchmark::State& state) { sheet_step(state, 158, state.range(0)); }
BENCHMARK(growth_pixels)
    ->RangeMultiplier(2)
    ->Range(128, 2048)
    ->Unit(benchmark::kMillisecond)
    ->UseRealTime();
void growth_faces(benchmark::State& state) {
  sheet_step(state, static_cast<int64_t>(std::sqrt(state.range(0) / 2)), 400);
}
BENCHMARK(growth_faces)
    ->RangeMultiplier(4)
    ->Range(1 << 10, 1 << 20)
    ->Unit(benchmark::kMillisecond)
    ->UseRealTime();

/// Hash encoding and MLP with the sizes of an attack step, forward and backward.
void growth_points(benchmark::State& state) {
  const field::HashGridShape shape{16, 16, 2048, 19, 2};
  const Tensor x = at::rand({state.range(0), 3}) * 2 - 1;
  const Tensor table = leaf(at::rand({shape.entries(), 2}));
  const std::vector<Tensor> weights = {leaf(at::rand({64, 32})), leaf(at::rand({64, 64})),
                                       leaf(at::rand({3, 64}))};
  for (auto _ : state) {
    field::mlp(field::hash_encode(x, table, shape), weights).sum().backward();
    table.mutable_grad().reset();
  }
}
BENCHMARK(growth_points)
    ->RangeMultiplier(4)
    ->Range(1 << 12, 1 << 20)
    ->Unit(benchmark::kMillisecond)
    ->UseRealTime();

// ---- The machine's limits -----------------------------------------------------------------------

/// a = b + s c over arrays far larger than any cache.
void roof_bandwidth(benchmark::State& state) {
  constexpr int64_t kCount = int64_t{1} << 25;
  const Tensor a = at::zeros({kCount}), b = at::ones({kCount}), c = at::ones({kCount});
  for (auto _ : state) at::add_out(const_cast<Tensor&>(a), b, c, 0.5);
  state.SetBytesProcessed(state.iterations() * kCount * 12);
}
BENCHMARK(roof_bandwidth)->Unit(benchmark::kMillisecond)->UseRealTime();

template <int kBytes>
struct LanesOf {
  typedef float Type __attribute__((vector_size(kBytes)));
};

/// `count` independent multiply-adds in vectors of kBytes. Twelve run at a time: enough to hide
/// their latency, and few enough for the registers. Returns a number that depends on all of them.
/// (They start from different numbers; otherwise the compiler would compute only one.)
template <int kBytes>
TT3D_HD float multiply_adds(int64_t count) {
  using Lanes = typename LanesOf<kBytes>::Type;
  constexpr int kChains = 12, kLanes = kBytes / sizeof(float);
  Lanes sums[kChains];
  for (int k = 0; k < kChains; ++k) sums[k] = Lanes{} + 0.1F * static_cast<float>(k);
  const Lanes factor = Lanes{} + 0.999F, term = Lanes{} + 0.001F;
  for (int64_t i = 0; i < count; i += kChains * kLanes) {
    for (Lanes& sum : sums) sum = sum * factor + term;
  }
  Lanes all = {};
  for (const Lanes& sum : sums) all += sum;
  float total = 0;
  for (int k = 0; k < kLanes; ++k) total += all[k];
  return total;
}
#define TT3D_ROOF_LOOP(TARGET, BYTES, T) \
  TARGET T multiply_add_loop(int64_t count) { return multiply_adds<BYTES>(count); }
TT3D_FOR_EACH_CPU(TT3D_ROOF_LOOP, float)
#undef TT3D_ROOF_LOOP

void roof_multiply_adds(benchmark::State& state) {
  constexpr int64_t kCount = 12 << 24;
  const int64_t threads = at::get_num_threads();
  for (auto _ : state) {
    at::parallel_for(0, threads, 1, [](int64_t first, int64_t last) {
      for (int64_t i = first; i < last; ++i) benchmark::DoNotOptimize(multiply_add_loop(kCount));
    });
  }
  state.SetItemsProcessed(state.iterations() * threads * kCount);
}
BENCHMARK(roof_multiply_adds)->Unit(benchmark::kMillisecond)->UseRealTime();

/// The colour network of an attack: 2^17 points, 35-64-64-6, forward and backward.
void mlp_ours(benchmark::State& state) {
  const Tensor x = leaf(at::rand({35, int64_t{1} << 17}));
  const std::vector<Tensor> weights = {leaf(at::rand({64, 35})), leaf(at::rand({64, 64})),
                                       leaf(at::rand({6, 64}))};
  const Tensor weight = at::rand({6, x.size(1)});
  for (auto _ : state) {
    field::mlp(x, weights).backward(weight);
    x.mutable_grad().reset();
  }
}
BENCHMARK(mlp_ours)->Unit(benchmark::kMillisecond)->UseRealTime();

// ---- Rasterizer against plain tensor operations, on a mesh small enough for their memory -----

constexpr int64_t kSheet = 22, kSheetPixels = 128;  // 968 triangles

void rasterize_ours(benchmark::State& state) {
  const auto [clip, faces] = sheet(kSheet);
  const Tensor positions = leaf(clip);
  for (auto _ : state) {
    const Tensor rast = raster::rasterize(positions, faces, kSheetPixels, kSheetPixels);
    rast.narrow(3, 0, 2).sum().backward();
    positions.mutable_grad().reset();
  }
}
BENCHMARK(rasterize_ours)->Unit(benchmark::kMillisecond)->UseRealTime();

void rasterize_plain_tensors(benchmark::State& state) {
  const auto [clip, faces] = sheet(kSheet);
  const Tensor positions = leaf(clip);
  for (auto _ : state) {
    Tensor rast;
    {
      at::NoGradGuard guard;
      rast = testing::reference_rasterize(positions, faces, kSheetPixels, kSheetPixels);
    }
    testing::reference_barycentrics(positions, rast, faces).sum().backward();
    positions.mutable_grad().reset();
  }
}
BENCHMARK(rasterize_plain_tensors)->Unit(benchmark::kMillisecond)->UseRealTime();

// ---- Hash encoding, 2^18 points, 16 levels, two features -------------------------------------

template <typename Encode>
void hash_encoding(benchmark::State& state, const Encode& encode) {
  const field::HashGridShape shape{16, 16, 2048, 19, 2};
  const Tensor x = at::rand({int64_t{1} << 18, 3}) * 2 - 1;
  const Tensor table = leaf(at::rand({shape.entries(), 2}));
  const Tensor weight = at::rand({32, x.size(0)});
  for (auto _ : state) {
    encode(x, table, shape).backward(weight);
    table.mutable_grad().reset();
  }
}

void hash_encode_ours(benchmark::State& state) { hash_encoding(state, hash_encode); }
BENCHMARK(hash_encode_ours)->Unit(benchmark::kMillisecond)->UseRealTime();

void hash_encode_plain_tensors(benchmark::State& state) {
  hash_encoding(state, testing::reference_encode);
}
BENCHMARK(hash_encode_plain_tensors)->Unit(benchmark::kMillisecond)->UseRealTime();

}  // namespace
}  // namespace tt3d

int main(int argc, char** argv) {
  at::set_num_threads(std::max(
      1, std::atoi(std::getenv("OMP_NUM_THREADS") ? std::getenv("OMP_NUM_THREADS") : "1")));
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
  benchmark::RunSpecifiedBenchmarks();
  benchmark::Shutdown();
}
