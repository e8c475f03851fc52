#include <algorithm>

#include "field_cpu.h"

namespace tt3d::field {
namespace {

constexpr int64_t kChunk = 8192;
constexpr int64_t kSlopeChunk = 1024;  ///< its sums stay in the first cache and on the stack

/// Corner k of the cell: bit 0 moves along x, bit 1 along y, bit 2 along z.
template <typename T>
struct Corner {
  uint32_t entry;
  T weight;
};

template <typename T>
TT3D_HD Corner<T> corner_of(int k, const uint32_t cell[3], const T fraction[3],
                            const HashLevel& level) {
  const uint32_t dx = k & 1, dy = (k >> 1) & 1, dz = (k >> 2) & 1;
  const T wx = dx ? fraction[0] : T(1) - fraction[0];
  const T wy = dy ? fraction[1] : T(1) - fraction[1];
  const T wz = dz ? fraction[2] : T(1) - fraction[2];
  return {entry_of(cell[0] + dx, cell[1] + dy, cell[2] + dz, level), wx * wy * wz};
}

template <typename T, int F, bool kDense>
TT3D_HD void encode_range(const T* __restrict points, const T* __restrict table, T* __restrict out,
                          int64_t begin, int64_t end, int64_t count, HashLevel level) {
  level.dense = kDense;
#pragma GCC ivdep
  for (int64_t i = begin; i < end; ++i) {
    uint32_t cell[3];
    T fraction[3];
    for (int k = 0; k < 3; ++k) locate(points[3 * i + k], level, cell[k], fraction[k]);
    T sum[F] = {};
    for (int k = 0; k < 8; ++k) {
      const Corner<T> c = corner_of(k, cell, fraction, level);
      for (int f = 0; f < F; ++f) sum[f] += c.weight * table[static_cast<int32_t>(c.entry) * F + f];
    }
    for (int f = 0; f < F; ++f) out[f * count + i] = sum[f];
  }
}

template <typename T, int F, bool kDense>
TT3D_HD void scatter_level(const T* __restrict points, const T* __restrict grad_out,
                           T* __restrict grad_table, int64_t count, HashLevel level) {
  level.dense = kDense;
  for (int64_t i = 0; i < count; ++i) {
    T g[F];
    bool zero = true;
    for (int f = 0; f < F; ++f) {
      g[f] = grad_out[f * count + i];
      zero = zero && g[f] == T(0);
    }
    if (zero) continue;
    uint32_t cell[3];
    T fraction[3];
    for (int k = 0; k < 3; ++k) locate(points[3 * i + k], level, cell[k], fraction[k]);
    for (int k = 0; k < 8; ++k) {
      const Corner<T> c = corner_of(k, cell, fraction, level);
      for (int f = 0; f < F; ++f) grad_table[c.entry * F + f] += c.weight * g[f];
    }
  }
}

/// Adds the level's part of the gradient with respect to the points to total [3,kSlopeChunk].
template <typename T, int F, bool kDense>
TT3D_HD void slope_range(const T* __restrict points, const T* __restrict table,
                         const T* __restrict grad_out, T* __restrict total, int64_t begin,
                         int64_t end, int64_t count, HashLevel level) {
  level.dense = kDense;
  const T stretch = static_cast<T>(level.scale) * T(0.5);
#pragma GCC ivdep
  for (int64_t i = begin; i < end; ++i) {
    uint32_t cell[3];
    T fraction[3];
    for (int k = 0; k < 3; ++k) locate(points[3 * i + k], level, cell[k], fraction[k]);
    T sum[3] = {};
    for (int k = 0; k < 8; ++k) {
      const uint32_t entry = corner_of(k, cell, fraction, level).entry;
      T value = 0;
      for (int f = 0; f < F; ++f) {
        value += table[static_cast<int32_t>(entry) * F + f] * grad_out[f * count + i];
      }
      T weight[3], sign[3];
      for (int axis = 0; axis < 3; ++axis) {
        const bool upper = (k >> axis) & 1;
        weight[axis] = upper ? fraction[axis] : T(1) - fraction[axis];
        sign[axis] = upper ? T(1) : T(-1);
      }
      sum[0] += value * sign[0] * weight[1] * weight[2];
      sum[1] += value * sign[1] * weight[0] * weight[2];
      sum[2] += value * sign[2] * weight[0] * weight[1];
    }
    for (int axis = 0; axis < 3; ++axis)
      total[axis * kSlopeChunk + i - begin] += sum[axis] * stretch;
  }
}

template <typename T, int F>
TT3D_HD void encode_level(const T* points, const T* table, T* out, int64_t begin, int64_t end,
                          int64_t count, const HashLevel& level) {
  if (level.dense)
    encode_range<T, F, true>(points, table, out, begin, end, count, level);
  else
    encode_range<T, F, false>(points, table, out, begin, end, count, level);
}

// target_clones needs plain functions: one for each type and feature count.
#define TT3D_HASH_LOOPS(T, F)                                                                   \
  TT3D_CPU_LOOP void encode_##T##F(const T* points, const T* table, T* out, int64_t begin,      \
                                   int64_t end, int64_t count, const HashLevel& level) {        \
    encode_level<T, F>(points, table, out, begin, end, count, level);                           \
  }                                                                                             \
  TT3D_CPU_LOOP void scatter_##T##F(const T* points, const T* grad_out, T* grad_table,          \
                                    int64_t count, const HashLevel& level) {                    \
    if (level.dense)                                                                            \
      scatter_level<T, F, true>(points, grad_out, grad_table, count, level);                    \
    else                                                                                        \
      scatter_level<T, F, false>(points, grad_out, grad_table, count, level);                   \
  }                                                                                             \
  TT3D_CPU_LOOP void slope_##T##F(const T* points, const T* table, const T* grad_out, T* total, \
                                  int64_t begin, int64_t end, int64_t count,                    \
                                  const HashLevel& level) {                                     \
    if (level.dense)                                                                            \
      slope_range<T, F, true>(points, table, grad_out, total, begin, end, count, level);        \
    else                                                                                        \
      slope_range<T, F, false>(points, table, grad_out, total, begin, end, count, level);       \
  }
TT3D_HASH_LOOPS(float, 1)
TT3D_HASH_LOOPS(float, 2)
TT3D_HASH_LOOPS(double, 1)
TT3D_HASH_LOOPS(double, 2)
#undef TT3D_HASH_LOOPS

template <typename T>
auto encode_loop(int64_t features) {
  if constexpr (std::is_same_v<T, float>)
    return features == 1 ? encode_float1 : encode_float2;
  else
    return features == 1 ? encode_double1 : encode_double2;
}

template <typename T>
auto scatter_loop(int64_t features) {
  if constexpr (std::is_same_v<T, float>)
    return features == 1 ? scatter_float1 : scatter_float2;
  else
    return features == 1 ? scatter_double1 : scatter_double2;
}

template <typename T>
auto slope_loop(int64_t features) {
  if constexpr (std::is_same_v<T, float>)
    return features == 1 ? slope_float1 : slope_float2;
  else
    return features == 1 ? slope_double1 : slope_double2;
}

}  // namespace

template <typename T>
void hash_encode_cpu(const T* points, const T* table, T* out, int64_t count,
                     const std::vector<HashLevel>& levels, int64_t features) {
  const auto encode = encode_loop<T>(features);
  const int64_t chunks = (count + kChunk - 1) / kChunk;
  const auto level_count = static_cast<int64_t>(levels.size());
  // Levels outermost, so that a thread's level table stays in its cache.
  at::parallel_for(0, level_count * chunks, 1, [&](int64_t first, int64_t last) {
    for (int64_t task = first; task < last; ++task) {
      const int64_t l = task / chunks, begin = task % chunks * kChunk;
      encode(points, table + levels[l].offset * features, out + l * features * count, begin,
             std::min(count, begin + kChunk), count, levels[l]);
    }
  });
}

template <typename T>
void hash_encode_backward_cpu(const T* points, const T* grad_out, T* grad_table, int64_t count,
                              const std::vector<HashLevel>& levels, int64_t features) {
  const auto scatter = scatter_loop<T>(features);
  at::parallel_for(0, static_cast<int64_t>(levels.size()), 1, [&](int64_t first, int64_t last) {
    for (int64_t l = first; l < last; ++l) {
      scatter(points, grad_out + l * features * count, grad_table + levels[l].offset * features,
              count, levels[l]);
    }
  });
}

template <typename T>
void hash_encode_backward_points_cpu(const T* points, const T* table, const T* grad_out,
                                     T* grad_points, int64_t count,
                                     const std::vector<HashLevel>& levels, int64_t features) {
  const auto slopes = slope_loop<T>(features);
  const int64_t chunks = (count + kSlopeChunk - 1) / kSlopeChunk;
  at::parallel_for(0, chunks, 1, [&](int64_t first, int64_t last) {
    for (int64_t chunk = first; chunk < last; ++chunk) {
      const int64_t begin = chunk * kSlopeChunk, end = std::min(count, begin + kSlopeChunk);
      T total[3 * kSlopeChunk] = {};
      for (size_t l = 0; l < levels.size(); ++l) {
        slopes(points, table + levels[l].offset * features,
               grad_out + static_cast<int64_t>(l) * features * count, total, begin, end, count,
               levels[l]);
      }
      for (int64_t i = begin; i < end; ++i) {
        for (int axis = 0; axis < 3; ++axis) {
          // Clamped coordinates do not move the look-up.
          const T x = points[3 * i + axis];
          const bool inside = x > T(-1) && x < T(1);
          grad_points[3 * i + axis] = inside ? total[axis * kSlopeChunk + i - begin] : T(0);
        }
      }
    }
  });
}

#define TT3D_INSTANTIATE(T)                                                                     \
  template void hash_encode_cpu(const T*, const T*, T*, int64_t, const std::vector<HashLevel>&, \
                                int64_t);                                                       \
  template void hash_encode_backward_cpu(const T*, const T*, T*, int64_t,                       \
                                         const std::vector<HashLevel>&, int64_t);               \
  template void hash_encode_backward_points_cpu(const T*, const T*, const T*, T*, int64_t,      \
                                                const std::vector<HashLevel>&, int64_t);
TT3D_INSTANTIATE(float)
TT3D_INSTANTIATE(double)
#undef TT3D_INSTANTIATE

}  // namespace tt3d::field
