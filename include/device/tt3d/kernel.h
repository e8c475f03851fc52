#pragma once

#include <cstdint>

/// The parts of a kernel body. No tensor library and no CUDA header is included here, so that the
/// same source compiles for the CPU and, with nvcc, for the GPU (docs/architecture.md).

/// Marks a function of a body: inlined, and on the GPU also a device function. A macro, because
/// attributes and __host__ __device__ have no other form that both compilers accept.
#ifdef __CUDACC__
#define TT3D_HD __host__ __device__ __forceinline__
#else
#define TT3D_HD inline __attribute__((always_inline))
#endif

/// Marks the CPU loop of a kernel: the compiler makes a version for AVX-512, AVX2 and plain x86-64,
/// and the loader picks the best one for the machine. TT3D_FOR_EACH_CPU(DEFINE, T) does the same
/// for loops with explicit vectors: it expands DEFINE(attributes, bytes of a vector, T) for each of
/// the three. Macros, because a template can neither be a target clone nor take a target as a
/// parameter. Kernel files define further macros: loops for float and double, for the same reason,
/// and TT3D_INSTANTIATE, because a list of explicit instantiations cannot be a template.
#if defined(__x86_64__) && !defined(__CUDACC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define TT3D_CPU_LOOP __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#define TT3D_FOR_EACH_CPU(DEFINE, T)                       \
  DEFINE(__attribute__((target("arch=x86-64-v4"))), 64, T) \
  DEFINE(__attribute__((target("arch=x86-64-v3"))), 32, T) \
  DEFINE(__attribute__((target("default"))), 16, T)
#else
#define TT3D_CPU_LOOP
#define TT3D_FOR_EACH_CPU(DEFINE, T) DEFINE(, 16, T)
#endif

namespace tt3d {

/// Executors: the processor that runs a loop, with the data it needs for that. `on_device_of`
/// (tt3d/device.h) picks one; loops are overloaded on them.
struct Cpu {};
struct Cuda {
  void* stream = nullptr;  ///< a cudaStream_t; void* avoids its header
};

/// Calls `body(i)` for every i in [0, n) on the GPU, one thread per item, and returns before the
/// GPU has finished. `body` is a struct with a TT3D_HD call operator and plain pointers. Defined in
/// tt3d/cuda.h; the .cu file of the body's room instantiates it, one line per body.
template <typename Body>
void for_each_index(const Cuda& on, int64_t n, const Body& body);

/// Element (i, j) of a dense row-major matrix: a pointer with its row length. It replaces tensors
/// in kernel bodies.
template <typename T>
struct TensorView {
  T* data = nullptr;
  int64_t rows = 0;
  int64_t cols = 0;
  TT3D_HD T& operator()(int64_t i, int64_t j) const { return data[i * cols + j]; }
  TT3D_HD T* row(int64_t i) const { return data + i * cols; }
};

/// Adds to a sum that several items share. Atomic on the GPU, in an order the hardware chooses.
/// Plain on the CPU: its executors give each sum to one thread, in item order.
template <typename T>
TT3D_HD void accumulate(T* sum, T value) {
#ifdef __CUDA_ARCH__
  atomicAdd(sum, value);
#else
  *sum += value;
#endif
}

/// Takes the next index of a list that many threads append to.
TT3D_HD int64_t take_place(int64_t* next) {
#ifdef __CUDA_ARCH__
  static_assert(sizeof(unsigned long long) == sizeof(int64_t));
  return static_cast<int64_t>(atomicAdd(reinterpret_cast<unsigned long long*>(next), 1ULL));
#else
  return (*next)++;
#endif
}

}  // namespace tt3d
