#pragma once

#include <cstdint>

/// What kernel bodies are made of: no tensor library and no CUDA header here, so that one text
/// compiles for the CPU and, by nvcc, for the GPU (design, section 4).

#ifdef __CUDACC__
#define TT3D_HD __host__ __device__ __forceinline__
#else
#define TT3D_HD inline __attribute__((always_inline))
#endif

/// Marks the CPU loop of a kernel: compiled for AVX-512, AVX2 and plain x86-64, the best one the
/// machine has chosen at load time. TT3D_FOR_EACH_CPU(DEFINE, T) does the same for loops that are
/// written in vectors: it expands DEFINE(attributes, bytes of a vector, T) for each of the three.
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

/// Executors: which processor runs a loop, and what it needs for that. `on_device_of`
/// (tt3d/device.h) picks one; loops are functions overloaded on them.
struct Cpu {};
struct Cuda {
  void* stream = nullptr;  ///< cudaStream_t, without its header
};

/// Calls `body(i)` for every i in [0, n) on the GPU, a thread an item, and returns before it is
/// done. `body` is a struct with a TT3D_HD call operator and plain pointers. Defined in tt3d/cuda.h
/// and instantiated, a line a body, in the .cu file of its room.
template <typename Body>
void for_each_index(const Cuda& on, int64_t n, const Body& body);

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

/// Adds to a sum that several items share. Atomic on the GPU, in the order the hardware takes; on
/// the CPU plain, since its executors give each sum to one thread, in item order.
template <typename T>
TT3D_HD void accumulate(T* sum, T value) {
#ifdef __CUDA_ARCH__
  atomicAdd(sum, value);
#else
  *sum += value;
#endif
}

/// Takes the next place in a list that many threads append to.
TT3D_HD int64_t take_place(int64_t* next) {
#ifdef __CUDA_ARCH__
  static_assert(sizeof(unsigned long long) == sizeof(int64_t));
  return static_cast<int64_t>(atomicAdd(reinterpret_cast<unsigned long long*>(next), 1ULL));
#else
  return (*next)++;
#endif
}

}  // namespace tt3d
