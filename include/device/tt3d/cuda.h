#pragma once

#include <cuda_runtime.h>

#include <algorithm>
#include <string>

#include "tt3d/error.h"
#include "tt3d/kernel.h"

/// The GPU's executor. For .cu files only; it includes no torch header.
namespace tt3d {

/// Throws ResourceError with the call, its place in the source and the runtime's message.
inline void check_cuda(cudaError_t status, const char* call, const char* file, int line) {
  if (status == cudaSuccess) return;
  throw ResourceError(std::string(file) + ":" + std::to_string(line) + ": " + call + ": " +
                      cudaGetErrorString(status));
}
/// A macro, because it stringises the call and takes its place in the source.
#define TT3D_CUDA_CHECK(call) ::tt3d::check_cuda((call), #call, __FILE__, __LINE__)

inline cudaStream_t stream_of(const Cuda& on) { return static_cast<cudaStream_t>(on.stream); }

namespace cuda_detail {

constexpr int kBlock = 256;

template <typename Body>
__global__ void __launch_bounds__(kBlock) index_kernel(int64_t n, Body body) {
  const int64_t stride = static_cast<int64_t>(gridDim.x) * kBlock;
  for (int64_t i = static_cast<int64_t>(blockIdx.x) * kBlock + threadIdx.x; i < n; i += stride) {
    body(i);
  }
}

}  // namespace cuda_detail

template <typename Body>
void for_each_index(const Cuda& on, int64_t n, const Body& body) {
  if (n <= 0) return;
  constexpr int64_t kMaxBlocks = 1 << 20;  // with more items, a thread takes several
  const int64_t blocks = std::min((n + cuda_detail::kBlock - 1) / cuda_detail::kBlock, kMaxBlocks);
  cuda_detail::
      index_kernel<<<static_cast<unsigned>(blocks), cuda_detail::kBlock, 0, stream_of(on)>>>(n,
                                                                                             body);
  TT3D_CUDA_CHECK(cudaGetLastError());
}

}  // namespace tt3d
