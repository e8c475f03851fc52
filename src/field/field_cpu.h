#pragma once

#include <cstdint>
#include <vector>

#include "hash_math.h"

/// CPU executors of the field's kernels: plain pointers in, plain pointers out. The same bytes
/// with any number of threads.
namespace tt3d::field {

/// Points [P,3] row-major; table [entries,F]; out [levels*F, P].
template <typename T>
void hash_encode_cpu(const T* points, const T* table, T* out, int64_t count,
                     const std::vector<HashLevel>& levels, int64_t features);
/// A thread owns levels: no atomics. Accumulates into grad_table.
template <typename T>
void hash_encode_backward_cpu(const T* points, const T* grad_out, T* grad_table, int64_t count,
                              const std::vector<HashLevel>& levels, int64_t features);
/// Gradient with respect to the points; overwrites grad_points [P,3].
template <typename T>
void hash_encode_backward_points_cpu(const T* points, const T* table, const T* grad_out,
                                     T* grad_points, int64_t count,
                                     const std::vector<HashLevel>& levels, int64_t features);

/// One layer's weights [out,in].
template <typename T>
struct Layer {
  const T* weights;
  int64_t in, out;
};
template <typename T>
void mlp_cpu(const T* x, const std::vector<Layer<T>>& layers, T* out, int64_t count);
/// grad_x may be null; grad_weights[k] are overwritten.
template <typename T>
void mlp_backward_cpu(const T* x, const std::vector<Layer<T>>& layers, const T* grad_out, T* grad_x,
                      const std::vector<T*>& grad_weights, int64_t count);

template <typename T>
void composite_cpu(const T* densities, const T* colors, const T* steps, const int64_t* ray_begin,
                   T* out, int64_t rays, int64_t samples);
template <typename T>
void composite_backward_cpu(const T* densities, const T* colors, const T* steps,
                            const int64_t* ray_begin, const T* grad_out, T* grad_densities,
                            T* grad_colors, int64_t rays, int64_t samples);

}  // namespace tt3d::field
