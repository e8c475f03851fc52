#pragma once

#include <cmath>
#include <cstdint>

#include "tt3d/kernel.h"

/// Bodies of the hash encoding: one point in one level (Mueller et al. 2022, section 3).
namespace tt3d::field {

struct HashLevel {
  float scale;          ///< cells along the unit interval
  uint32_t resolution;  ///< grid points per side
  uint32_t size;        ///< entries
  bool dense;           ///< one entry per grid point, no hashing
  int64_t offset;       ///< first entry in the table
};

/// Cell corner and position inside the cell of coordinate x in [-1,1].
template <typename T>
TT3D_HD void locate(T x, const HashLevel& level, uint32_t& cell, T& fraction) {
  T unit = (x + T(1)) * T(0.5);
  unit = unit < T(0) ? T(0) : (unit > T(1) ? T(1) : unit);
  const T position = unit * static_cast<T>(level.scale) + T(0.5);
  const auto floored = static_cast<int32_t>(position);
  cell = static_cast<uint32_t>(floored);
  fraction = position - static_cast<T>(floored);
}

/// Entry of a grid point: its index if the level is dense, else the paper's hash (eq. 4).
TT3D_HD uint32_t entry_of(uint32_t x, uint32_t y, uint32_t z, const HashLevel& level) {
  if (level.dense) return x + level.resolution * (y + level.resolution * z);
  return (x ^ (y * 2654435761U) ^ (z * 805459861U)) & (level.size - 1U);
}

/// All levels, small enough to be a kernel's argument.
struct HashLevels {
  static constexpr int64_t kMaxLevels = 32;
  HashLevel level[kMaxLevels];
  int64_t count;
};

/// A grid point of a cell: its entry, and its interpolation weight at the encoded point.
template <typename T>
struct Corner {
  uint32_t entry;
  T weight;
};

/// Entry of corner k of the cell: bit 0 of k steps along x, bit 1 along y, bit 2 along z.
TT3D_HD uint32_t corner_entry(int k, const uint32_t cell[3], const HashLevel& level) {
  return entry_of(cell[0] + (k & 1), cell[1] + ((k >> 1) & 1), cell[2] + ((k >> 2) & 1), level);
}

/// Its interpolation weight.
template <typename T>
TT3D_HD T corner_weight(int k, const T fraction[3]) {
  const T wx = k & 1 ? fraction[0] : T(1) - fraction[0];
  const T wy = (k >> 1) & 1 ? fraction[1] : T(1) - fraction[1];
  const T wz = (k >> 2) & 1 ? fraction[2] : T(1) - fraction[2];
  return wx * wy * wz;
}

/// Entry and weight of corner k of the cell.
template <typename T>
TT3D_HD Corner<T> corner_of(int k, const uint32_t cell[3], const T fraction[3],
                            const HashLevel& level) {
  return {corner_entry(k, cell, level), corner_weight(k, fraction)};
}

/// The features of one entry, loaded together.
template <typename T, int F>
struct Entry {
  T value[F];
};

template <typename T, int F>
TT3D_HD Entry<T, F> load_entry(const T* table, uint32_t entry) {
  Entry<T, F> e;
#ifdef __CUDA_ARCH__
  struct alignas(sizeof(T) * F) Whole {
    T value[F];
  };
  const auto whole = reinterpret_cast<const Whole*>(table)[entry];
  for (int f = 0; f < F; ++f) e.value[f] = whole.value[f];
#else
  if constexpr (sizeof(T) == 4 && F == 2) {
    // One 64-bit load for both floats: loops then need half the loads. (A struct would prevent
    // their vectorisation.)
    typedef uint64_t Pair __attribute__((may_alias, aligned(4)));
    const uint64_t bits = reinterpret_cast<const Pair*>(table)[static_cast<int32_t>(entry)];
    e.value[0] = __builtin_bit_cast(float, static_cast<uint32_t>(bits));
    e.value[1] = __builtin_bit_cast(float, static_cast<uint32_t>(bits >> 32));
  } else {
    for (int f = 0; f < F; ++f) e.value[f] = table[static_cast<int32_t>(entry) * F + f];
  }
#endif
  return e;
}

/// sum[F] += weight * the entry's features.
template <typename T, int F>
TT3D_HD void add_entry(const T* table, uint32_t entry, T weight, T sum[F]) {
  const auto e = load_entry<T, F>(table, entry);
  for (int f = 0; f < F; ++f) sum[f] += weight * e.value[f];
}

/// Dot product of the entry's features and grad[F].
template <typename T, int F>
TT3D_HD T dot_entry(const T* table, uint32_t entry, const T grad[F]) {
  const auto e = load_entry<T, F>(table, entry);
  T value = 0;
  for (int f = 0; f < F; ++f) value += e.value[f] * grad[f];
  return value;
}

/// Adds to one entry. From sm_90 on, the GPU adds two floats with one atomic.
template <typename T, int F>
TT3D_HD void add_to_entry(T* table, uint32_t entry, T weight, const T value[F]) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900
  constexpr bool kPair = sizeof(T) == sizeof(float) && F == 2;
#else
  constexpr bool kPair = false;
#endif
  if constexpr (kPair) {
#ifdef __CUDA_ARCH__
    atomicAdd(reinterpret_cast<float2*>(table + static_cast<int64_t>(entry) * 2),
              make_float2(weight * value[0], weight * value[1]));
#endif
  } else {
    for (int f = 0; f < F; ++f) accumulate(table + entry * F + f, weight * value[f]);
  }
}

#ifdef __CUDA_ARCH__
/// The lower of two entries if they share an aligned block of 16 bytes, as those of every second
/// edge along x do; else null.
template <typename T>
__device__ T* lower_of_pair(T* table, uint32_t a, uint32_t b) {
  const uint32_t lower = a < b ? a : b;
  T* at = table + static_cast<int64_t>(lower) * 2;
  const bool beside = a + 1 == b || b + 1 == a;
  return beside && reinterpret_cast<uintptr_t>(at) % sizeof(float4) == 0 ? at : nullptr;
}
#endif

/// A cell's edge along x: two grid points.
template <typename T>
struct Edge {
  Corner<T> at[2];
};

/// sum[F] += weighted features of the edge's two points. The GPU loads both together if possible.
template <typename T, int F>
TT3D_HD void add_edge(const T* table, const Edge<T>& edge, T sum[F]) {
#ifdef __CUDA_ARCH__
  if constexpr (sizeof(T) == sizeof(float) && F == 2) {
    if (const T* both = lower_of_pair(table, edge.at[0].entry, edge.at[1].entry)) {
      const auto four = *reinterpret_cast<const float4*>(both);
      const bool rising = edge.at[0].entry < edge.at[1].entry;
      const T low = edge.at[rising ? 0 : 1].weight, high = edge.at[rising ? 1 : 0].weight;
      sum[0] += low * four.x + high * four.z;
      sum[1] += low * four.y + high * four.w;
      return;
    }
  }
#endif
  for (const Corner<T>& c : edge.at) add_entry<T, F>(table, c.entry, c.weight, sum);
}

/// Adds value[F] to both points, times their weights; with one atomic on the GPU if possible
/// (sm_90).
template <typename T, int F>
TT3D_HD void add_to_edge(T* table, const Edge<T>& edge, const T value[F]) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900
  if constexpr (sizeof(T) == sizeof(float) && F == 2) {
    if (T* both = lower_of_pair(table, edge.at[0].entry, edge.at[1].entry)) {
      const bool rising = edge.at[0].entry < edge.at[1].entry;
      const T low = edge.at[rising ? 0 : 1].weight, high = edge.at[rising ? 1 : 0].weight;
      atomicAdd(reinterpret_cast<float4*>(both),
                make_float4(low * value[0], low * value[1], high * value[0], high * value[1]));
      return;
    }
  }
#endif
  for (const Corner<T>& c : edge.at) add_to_entry<T, F>(table, c.entry, c.weight, value);
}

/// sum[F] += the encoding of point x[3] in a level whose entries begin at `table`.
template <typename T, int F>
TT3D_HD void encode_point(const T* x, const T* table, const HashLevel& level, T sum[F]) {
  uint32_t cell[3];
  T fraction[3];
  for (int k = 0; k < 3; ++k) locate(x[k], level, cell[k], fraction[k]);
  for (int f = 0; f < F; ++f) sum[f] = 0;
  for (int k = 0; k < 8; k += 2) {
    const Edge<T> edge = {
        {corner_of(k, cell, fraction, level), corner_of(k + 1, cell, fraction, level)}};
    add_edge<T, F>(table, edge, sum);
  }
}

template <typename T, int F>
TT3D_HD bool is_zero(const T grad[F]) {
  bool zero = true;
  for (int f = 0; f < F; ++f) zero = zero && grad[f] == T(0);
  return zero;
}

/// Backward of encode_point: adds grad[F] to the cell's entries.
template <typename T, int F>
TT3D_HD void scatter_point(const T* x, const T grad[F], T* grad_table, const HashLevel& level) {
  if (is_zero<T, F>(grad)) return;
  uint32_t cell[3];
  T fraction[3];
  for (int k = 0; k < 3; ++k) locate(x[k], level, cell[k], fraction[k]);
  for (int k = 0; k < 8; k += 2) {
    const Edge<T> edge = {
        {corner_of(k, cell, fraction, level), corner_of(k + 1, cell, fraction, level)}};
    add_to_edge<T, F>(grad_table, edge, grad);
  }
}

/// Body: point i % count in level i / count; points [count,3], out [levels * F, count].
template <typename T, int F>
struct HashEncodeItem {
  const T* points;
  const T* table;
  T* out;
  int64_t count;
  HashLevels levels;
  TT3D_HD void operator()(int64_t i) const {
    const int64_t l = i / count, p = i % count;
    const HashLevel& level = levels.level[l];
    T sum[F];
    encode_point<T, F>(points + 3 * p, table + level.offset * F, level, sum);
    for (int f = 0; f < F; ++f) out[(l * F + f) * count + p] = sum[f];
  }
};

template <typename T, int F>
struct HashScatterItem {
  const T* points;
  const T* grad_out;
  T* grad_table;
  int64_t count;
  HashLevels levels;
  TT3D_HD void operator()(int64_t i) const {
    const int64_t l = i / count, p = i % count;
    const HashLevel& level = levels.level[l];
    T grad[F];
    for (int f = 0; f < F; ++f) grad[f] = grad_out[(l * F + f) * count + p];
    scatter_point<T, F>(points + 3 * p, grad, grad_table + level.offset * F, level);
  }
};

/// Derivatives of the trilinear interpolation of a cell's eight values with respect to the position
/// inside the cell. Interpolates along x, then y, then z, so that intermediate results are reused.
template <typename T>
TT3D_HD void slope_of_cell(const T v[8], const T fraction[3], T sum[3]) {
  T along_x[4], at_x[4];  // for the cell's four edges along x
  for (int64_t k = 0; k < 4; ++k) {
    along_x[k] = v[2 * k + 1] - v[2 * k];
    at_x[k] = v[2 * k] + along_x[k] * fraction[0];
  }
  T slope_x[2], along_y[2], at_y[2];  // for its lower and upper face
  for (int k = 0; k < 2; ++k) {
    slope_x[k] = along_x[2 * k] + (along_x[2 * k + 1] - along_x[2 * k]) * fraction[1];
    along_y[k] = at_x[2 * k + 1] - at_x[2 * k];
    at_y[k] = at_x[2 * k] + along_y[k] * fraction[1];
  }
  sum[0] = slope_x[0] + (slope_x[1] - slope_x[0]) * fraction[2];
  sum[1] = along_y[0] + (along_y[1] - along_y[0]) * fraction[2];
  sum[2] = at_y[1] - at_y[0];
}

/// Gradient of encode_point, multiplied with grad[F], with respect to the position inside the cell.
template <typename T, int F>
TT3D_HD void slope_of_point(const T* x, const T* table, const T grad[F], const HashLevel& level,
                            T sum[3]) {
  uint32_t cell[3];
  T fraction[3], v[8];
  for (int k = 0; k < 3; ++k) locate(x[k], level, cell[k], fraction[k]);
  for (int k = 0; k < 8; ++k) v[k] = dot_entry<T, F>(table, corner_entry(k, cell, level), grad);
  slope_of_cell(v, fraction, sum);
}

/// Derivative of the position inside a level's cell with respect to the point.
template <typename T>
TT3D_HD T stretch_of(const HashLevel& level) {
  return static_cast<T>(level.scale) * T(0.5);
}

/// Whether a coordinate has a gradient: clamped ones do not.
template <typename T>
TT3D_HD bool is_inside(T x) {
  return x > T(-1) && x < T(1);
}

/// Body: the gradient with respect to point i; overwrites it.
template <typename T, int F>
struct HashPointGradient {
  const T* points;
  const T* table;
  const T* grad_out;
  T* grad_points;
  int64_t count;
  HashLevels levels;
  TT3D_HD void operator()(int64_t i) const {
    T total[3] = {};
    for (int64_t l = 0; l < levels.count; ++l) {
      const HashLevel& level = levels.level[l];
      T grad[F], sum[3];
      for (int f = 0; f < F; ++f) grad[f] = grad_out[(l * F + f) * count + i];
      slope_of_point<T, F>(points + 3 * i, table + level.offset * F, grad, level, sum);
      for (int axis = 0; axis < 3; ++axis) total[axis] += sum[axis] * stretch_of<T>(level);
    }
    for (int axis = 0; axis < 3; ++axis) {
      grad_points[3 * i + axis] = is_inside(points[3 * i + axis]) ? total[axis] : T(0);
    }
  }
};

}  // namespace tt3d::field
