#pragma once

#include <cstdint>
#include <vector>

#include "hash_math.h"

/// Loops over the field's bodies that need more than for_each_index. Inputs and outputs are plain
/// pointers. On the CPU every result has the same bytes with any number of threads.
namespace tt3d::field {

/// Points [P,3] row-major; table [entries,F]; out [levels*F, P]. If `slopes` [levels*F, 3, P] is
/// not null, it receives the derivatives of `out` along the axes. They cost little here, because
/// the entries are already loaded.
template <typename T>
void hash_encode(const Cpu&, const T* points, const T* table, T* out, T* slopes, int64_t count,
                 const HashLevels& levels, int64_t features);
/// A thread owns whole levels, so no atomics are needed. Overwrites grad_table.
template <typename T>
void hash_encode_backward(const Cpu&, const T* points, const T* grad_out, T* grad_table,
                          int64_t count, const HashLevels& levels, int64_t features);
/// Gradient with respect to the points; overwrites grad_points [P,3].
template <typename T>
void hash_encode_backward_points(const Cpu&, const T* points, const T* table, const T* slopes,
                                 const T* grad_out, T* grad_points, int64_t count,
                                 const HashLevels& levels, int64_t features);

/// The same on the GPU: one thread per point and level. Gradients are added to grad_table with
/// atomics. No slopes are kept: the backward pass looks the entries up again.
template <typename T>
void hash_encode(const Cuda& on, const T* points, const T* table, T* out, T* /*slopes*/,
                 int64_t count, const HashLevels& levels, int64_t features) {
  const int64_t items = count * levels.count;
  if (features == 1)
    for_each_index(on, items, HashEncodeItem<T, 1>{points, table, out, count, levels});
  else
    for_each_index(on, items, HashEncodeItem<T, 2>{points, table, out, count, levels});
}
template <typename T>
void hash_encode_backward(const Cuda& on, const T* points, const T* grad_out, T* grad_table,
                          int64_t count, const HashLevels& levels, int64_t features) {
  const int64_t items = count * levels.count;
  if (features == 1)
    for_each_index(on, items, HashScatterItem<T, 1>{points, grad_out, grad_table, count, levels});
  else
    for_each_index(on, items, HashScatterItem<T, 2>{points, grad_out, grad_table, count, levels});
}

template <typename T>
void hash_encode_backward_points(const Cuda& on, const T* points, const T* table,
                                 const T* /*slopes*/, const T* grad_out, T* grad_points,
                                 int64_t count, const HashLevels& levels, int64_t features) {
  if (features == 1)
    for_each_index(on, count,
                   HashPointGradient<T, 1>{points, table, grad_out, grad_points, count, levels});
  else
    for_each_index(on, count,
                   HashPointGradient<T, 2>{points, table, grad_out, grad_points, count, levels});
}

/// Weights [out,in] of one layer.
template <typename T>
struct Layer {
  const T* weights;
  int64_t in, out;
};
/// The MLP of the CPU; the GPU uses matrix products (field_op.cpp).
template <typename T>
void mlp_cpu(const T* x, const std::vector<Layer<T>>& layers, T* out, int64_t count);
/// grad_x may be null; grad_weights[k] are overwritten.
template <typename T>
void mlp_backward_cpu(const T* x, const std::vector<Layer<T>>& layers, const T* grad_out, T* grad_x,
                      const std::vector<T*>& grad_weights, int64_t count);

}  // namespace tt3d::field
