#pragma once

#include <cstdint>
#include <vector>

#include "adam_math.h"
#include "hash_math.h"

/// Loops over the field's bodies that need more than for_each_index: plain pointers in, plain
/// pointers out. On the CPU the same bytes with any number of threads.
namespace tt3d::field {

/// Points [P,3] row-major; table [entries,F]; out [levels*F, P]. Where `slopes` [levels*F, 3, P] is
/// not null, it gets the derivatives of `out` along the axes, which cost little while the entries
/// are at hand.
template <typename T>
void hash_encode(const Cpu&, const T* points, const T* table, T* out, T* slopes, int64_t count,
                 const HashLevels& levels, int64_t features);
/// A thread owns levels: no atomics. Overwrites grad_table.
template <typename T>
void hash_encode_backward(const Cpu&, const T* points, const T* grad_out, T* grad_table,
                          int64_t count, const HashLevels& levels, int64_t features);
/// Gradient with respect to the points; overwrites grad_points [P,3].
template <typename T>
void hash_encode_backward_points(const Cpu&, const T* points, const T* table, const T* slopes,
                                 const T* grad_out, T* grad_points, int64_t count,
                                 const HashLevels& levels, int64_t features);

/// The same on the GPU: a thread a point and level, gradients with atomics, which add to
/// grad_table. It keeps no slopes, but looks the entries up again.
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

/// Adam's loop on the CPU, in the place of the general one.
void for_each_index(const Cpu&, int64_t n, const AdamEntry& body);

/// One layer's weights [out,in].
template <typename T>
struct Layer {
  const T* weights;
  int64_t in, out;
};
/// The MLP of the CPU; on the GPU the layers are matrix products (field_op.cpp).
template <typename T>
void mlp_cpu(const T* x, const std::vector<Layer<T>>& layers, T* out, int64_t count);
/// grad_x may be null; grad_weights[k] are overwritten.
template <typename T>
void mlp_backward_cpu(const T* x, const std::vector<Layer<T>>& layers, const T* grad_out, T* grad_x,
                      const std::vector<T*>& grad_weights, int64_t count);

}  // namespace tt3d::field
