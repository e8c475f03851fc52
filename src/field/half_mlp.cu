#include <cuda_fp16.h>

#include "half_mlp_math.h"
#include "tt3d/cuda.h"

// The MLPs in half precision on tensor cores, one team per block of threads. A warp's lanes hold
// tiles in the layout of the instructions mma.m16n8k16 and ldmatrix (PTX ISA, "Matrix fragments for
// mma.m16n8k16 with floating point type").
namespace tt3d::field {
namespace {

constexpr int kWarp = 32;

__device__ int lane() { return static_cast<int>(threadIdx.x) % kWarp; }

/// Row and column of number h of register r in a lane's factors.
__device__ int row_of(int r) { return lane() / 4 + 8 * (r % 2); }
__device__ int column_of(int r, int h) { return lane() % 4 * 2 + h + 8 * (r / 2); }

__device__ uint32_t pack(float low, float high) {
  const __half2 both = __floats2half2_rn(clamp_to_half(low), clamp_to_half(high));
  return reinterpret_cast<const uint32_t&>(both);
}

/// Loads four tiles of 8 x 8. Each lane gives the address of one row: row lane % 8 of tile lane /
/// 8.
__device__ void load_tiles(uint32_t (&to)[4], const Half* row) {
  const auto from = static_cast<uint32_t>(__cvta_generic_to_shared(row));
  asm volatile("ldmatrix.sync.aligned.m8n8.x4.shared.b16 {%0,%1,%2,%3}, [%4];"
               : "=r"(to[0]), "=r"(to[1]), "=r"(to[2]), "=r"(to[3])
               : "r"(from)
               : "memory");
}
__device__ void load_turned_tiles(uint32_t (&to)[4], const Half* row) {
  const auto from = static_cast<uint32_t>(__cvta_generic_to_shared(row));
  asm volatile("ldmatrix.sync.aligned.m8n8.x4.trans.shared.b16 {%0,%1,%2,%3}, [%4];"
               : "=r"(to[0]), "=r"(to[1]), "=r"(to[2]), "=r"(to[3])
               : "r"(from)
               : "memory");
}

/// sums[0..3] += a b for a tile b of eight columns.
__device__ void multiply_add(float* sums, const uint32_t (&a)[4], uint32_t b0, uint32_t b1) {
  asm("mma.sync.aligned.m16n8k16.row.col.f32.f16.f16.f32 {%0,%1,%2,%3}, {%4,%5,%6,%7}, {%8,%9}, "
      "{%0,%1,%2,%3};"
      : "+f"(sums[0]), "+f"(sums[1]), "+f"(sums[2]), "+f"(sums[3])
      : "r"(a[0]), "r"(a[1]), "r"(a[2]), "r"(a[3]), "r"(b0), "r"(b1));
}

struct LaneSums;

/// A lane's part of a tile of factors: register r holds two adjacent numbers of a row.
struct LaneFactors {
  uint32_t value[4];

  template <typename Get>
  __device__ void set(const Get& get) {
    for (int r = 0; r < 4; ++r) {
      value[r] = pack(get(row_of(r), column_of(r, 0)), get(row_of(r), column_of(r, 1)));
    }
  }
  __device__ void set_rectified(const LaneSums& sums);
  __device__ void set_masked(const LaneSums& sums, const LaneFactors& positive);
  __device__ void store(Half* to, int stride) const {
    for (int r = 0; r < 4; ++r) {
      *reinterpret_cast<uint32_t*>(to + row_of(r) * stride + column_of(r, 0)) = value[r];
    }
  }
};

/// A lane's part of a tile of sums: numbers 2 r and 2 r + 1 have the position of register r in
/// LaneFactors.
struct LaneSums {
  float value[8];

  __device__ void clear() {
    for (float& v : value) v = 0;
  }
  __device__ void add_product(const LaneFactors& a, const Half* b, int stride) {
    const int row = lane() % 8 + lane() / 16 * 8, column = lane() / 8 % 2 * 8;
    uint32_t tiles[4];
    load_tiles(tiles, b + row * stride + column);
    multiply_add(value, a.value, tiles[0], tiles[1]);
    multiply_add(value + 4, a.value, tiles[2], tiles[3]);
  }
  __device__ void add_turned_product(const Half* a, const Half* b, int stride) {
    const int low = lane() % 8, side = lane() / 8 % 2 * 8, far = lane() / 16 * 8;
    uint32_t left[4], right[4];
    load_turned_tiles(left, a + (low + far) * stride + side);
    load_turned_tiles(right, b + (low + side) * stride + far);
    multiply_add(value, left, right[0], right[1]);
    multiply_add(value + 4, left, right[2], right[3]);
  }
  template <typename Use>
  __device__ void each(const Use& use) const {
    for (int e = 0; e < 8; ++e) use(row_of(e / 2), column_of(e / 2, e % 2), value[e]);
  }
};

__device__ void LaneFactors::set_rectified(const LaneSums& sums) {
  const auto rectified = [](float v) { return v < 0 ? 0.0F : v; };
  for (int r = 0; r < 4; ++r) {
    value[r] = pack(rectified(sums.value[2 * r]), rectified(sums.value[2 * r + 1]));
  }
}

__device__ void LaneFactors::set_masked(const LaneSums& sums, const LaneFactors& positive) {
  for (int r = 0; r < 4; ++r) {
    const auto& two = reinterpret_cast<const __half2&>(positive.value[r]);
    value[r] = pack(__low2float(two) > 0 ? sums.value[2 * r] : 0.0F,
                    __high2float(two) > 0 ? sums.value[2 * r + 1] : 0.0F);
  }
}

struct BlockTeam {
  using Factors = LaneFactors;
  using Sums = LaneSums;
  static constexpr int kShare = kMaxTiles * kMaxTiles / kTeamWarps;
  __device__ static int thread() { return static_cast<int>(threadIdx.x); }
  __device__ static int threads() { return kWarp * kTeamWarps; }
  __device__ static int warp() { return thread() / kWarp; }
  __device__ static int warps() { return kTeamWarps; }
  __device__ static void sync() { __syncthreads(); }
};

template <typename Share>
__global__ void __launch_bounds__(kWarp* kTeamWarps) team_kernel(Share share) {
  extern __shared__ __align__(128) char memory[];
  share(BlockTeam{}, memory, blockIdx.x, gridDim.x);
}

}  // namespace

template <typename Share>
void run_teams(const Cuda& on, int64_t teams, const Share& share) {
  const auto bytes = static_cast<int>(share.bytes(kTeamWarps));
  TT3D_CUDA_CHECK(
      cudaFuncSetAttribute(team_kernel<Share>, cudaFuncAttributeMaxDynamicSharedMemorySize, bytes));
  team_kernel<Share>
      <<<static_cast<unsigned>(teams), kWarp * kTeamWarps, bytes, stream_of(on)>>>(share);
  TT3D_CUDA_CHECK(cudaGetLastError());
}

#define TT3D_INSTANTIATE(LAYERS)                                             \
  template void run_teams(const Cuda&, int64_t, const HalfForward<LAYERS>&); \
  template void run_teams(const Cuda&, int64_t, const HalfBackward<LAYERS>&);
TT3D_FOR_EACH_DEPTH(TT3D_INSTANTIATE)
#undef TT3D_INSTANTIATE

}  // namespace tt3d::field
