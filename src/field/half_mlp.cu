#include <mma.h>

#include <type_traits>

#include "half_mlp_math.h"
#include "tt3d/cuda.h"

// The networks in half precision on tensor cores, a block of threads a team.
namespace tt3d::field {
namespace {

namespace wmma = nvcuda::wmma;

constexpr int kWarp = 32, kWarps = kTeamWarps;

/// A product's sum in the registers of a warp.
struct CoreTile {
  wmma::fragment<wmma::accumulator, kTile, kTile, kTile, float> sum;

  __device__ void clear() { wmma::fill_fragment(sum, 0.0F); }
  __device__ void load(const float* from) {
    wmma::load_matrix_sync(sum, from, kTile, wmma::mem_row_major);
  }
  __device__ void store(float* to) const {
    wmma::store_matrix_sync(to, sum, kTile, wmma::mem_row_major);
  }
  template <bool kTurnedA, bool kTurnedB>
  __device__ void add_product(const Half* a, int stride_a, const Half* b, int stride_b) {
    wmma::fragment<wmma::matrix_a, kTile, kTile, kTile, __half, Order<kTurnedA>> left;
    wmma::fragment<wmma::matrix_b, kTile, kTile, kTile, __half, Order<kTurnedB>> right;
    wmma::load_matrix_sync(left, reinterpret_cast<const __half*>(a), stride_a);
    wmma::load_matrix_sync(right, reinterpret_cast<const __half*>(b), stride_b);
    wmma::mma_sync(sum, left, right, sum);
  }

 private:
  template <bool kTurned>
  using Order = std::conditional_t<kTurned, wmma::col_major, wmma::row_major>;
};

struct BlockTeam {
  using Tile = CoreTile;
  __device__ static int thread() { return static_cast<int>(threadIdx.x); }
  __device__ static int threads() { return kWarp * kWarps; }
  __device__ static int warp() { return thread() / kWarp; }
  __device__ static int warps() { return kWarps; }
  __device__ static int lane() { return thread() % kWarp; }
  __device__ static int lanes() { return kWarp; }
  __device__ static void sync() { __syncthreads(); }
  __device__ static void sync_warp() { __syncwarp(); }
};

template <typename Share>
__global__ void __launch_bounds__(kWarp* kWarps) team_kernel(Share share) {
  extern __shared__ __align__(128) char memory[];
  share(BlockTeam{}, memory, blockIdx.x, gridDim.x);
}

}  // namespace

template <typename Share>
void run_teams(const Cuda& on, int64_t teams, const Share& share) {
  const auto bytes = static_cast<int>(share.bytes(kWarps));
  TT3D_CUDA_CHECK(
      cudaFuncSetAttribute(team_kernel<Share>, cudaFuncAttributeMaxDynamicSharedMemorySize, bytes));
  team_kernel<Share><<<static_cast<unsigned>(teams), kWarp * kWarps, bytes, stream_of(on)>>>(share);
  TT3D_CUDA_CHECK(cudaGetLastError());
}

template void run_teams(const Cuda&, int64_t, const HalfForward&);
template void run_teams(const Cuda&, int64_t, const HalfBackward&);

}  // namespace tt3d::field
