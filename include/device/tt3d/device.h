#pragma once

#include <ATen/Parallel.h>

#include <cstdint>

/// One maths body for CPU and CUDA (design, section 4): TT3D_HD marks functions that compile for
/// both, TensorView is what they take instead of tensors, and the loops below execute them.

#ifdef __CUDACC__
#define TT3D_HD __host__ __device__ __forceinline__
#else
#define TT3D_HD inline __attribute__((always_inline))
#endif

/// Marks the CPU loop of a kernel: compiled for AVX-512, AVX2 and plain x86-64, the best one the
/// machine has chosen at load time.
#if defined(__x86_64__) && !defined(__CUDACC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define TT3D_CPU_LOOP __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define TT3D_CPU_LOOP
#endif

namespace tt3d {

/// A pointer with a row length: element (i, j) of a dense row-major matrix. Knows no tensor
/// library, so kernel bodies stay free of it.
template <typename T>
struct TensorView {
  T* data = nullptr;
  int64_t rows = 0;
  int64_t cols = 0;
  TT3D_HD T& operator()(int64_t i, int64_t j) const { return data[i * cols + j]; }
  TT3D_HD T* row(int64_t i) const { return data + i * cols; }
};

/// Calls `body(begin, end)` over [0, n) in chunks of exactly `chunk` items (the last may be
/// shorter), whatever the number of threads: per-chunk results that are combined in chunk order
/// give the same bytes with 1 or N threads.
template <typename Body>
void for_each_chunk(int64_t n, int64_t chunk, const Body& body) {
  const int64_t chunks = (n + chunk - 1) / chunk;
  at::parallel_for(0, chunks, 1, [&](int64_t first, int64_t last) {
    for (int64_t c = first; c < last; ++c) body(c * chunk, std::min(n, (c + 1) * chunk));
  });
}

/// Calls `body(i)` for every i in [0, n), in parallel; for independent items.
template <typename Body>
void for_each_index(int64_t n, const Body& body) {
  at::parallel_for(0, n, 1024, [&](int64_t first, int64_t last) {
    for (int64_t i = first; i < last; ++i) body(i);
  });
}

}  // namespace tt3d
