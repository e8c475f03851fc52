#include <algorithm>

#include "field_kernels.h"
#include "tt3d/device.h"

namespace tt3d::field {
namespace {

constexpr int64_t kChunk = 8192;
constexpr int64_t kSlopeChunk = 1024;  ///< points; their sums fit into the L1 cache and the stack

/// The cells of a block of points. All entry indices are computed first, in vectors. Loads and adds
/// then never wait for an address, and many memory accesses are in flight at once.
template <typename T>
struct Cells {
  static constexpr int64_t kCount = 64;
  uint32_t entry[8][kCount];
  T fraction[3][kCount], weight[8][kCount];

  /// For points whose entries, F features each, are in `table`.
  template <int F>
  TT3D_HD void find(const T* __restrict points, const T* table, int64_t count,
                    const HashLevel& level) {
#pragma GCC ivdep
    for (int64_t i = 0; i < count; ++i) {
      uint32_t cell[3];
      for (int k = 0; k < 3; ++k) locate(points[3 * i + k], level, cell[k], fraction[k][i]);
      for (int k = 0; k < 8; ++k) entry[k][i] = corner_entry(k, cell, level);
    }
    for (const auto& corner : entry) {
      for (int64_t i = 0; i < count; ++i) __builtin_prefetch(table + int64_t{corner[i]} * F);
    }
  }
  TT3D_HD void weigh(int64_t count) {
#pragma GCC ivdep
    for (int64_t i = 0; i < count; ++i) {
      const T at[3] = {fraction[0][i], fraction[1][i], fraction[2][i]};
      for (int k = 0; k < 8; ++k) weight[k][i] = corner_weight(k, at);
    }
  }
};

template <typename T, int F, bool kDense, bool kSlopes>
TT3D_HD void encode_range(const T* __restrict points, const T* __restrict table, T* __restrict out,
                          T* __restrict slopes, int64_t begin, int64_t end, int64_t count,
                          HashLevel level) {
  level.dense = kDense;
  const T stretch = stretch_of<T>(level);
  Cells<T> cells;
  for (int64_t first = begin; first < end; first += cells.kCount) {
    const int64_t size = std::min(cells.kCount, end - first);
    cells.template find<F>(points + 3 * first, table, size, level);
    cells.weigh(size);
    T sums[F][cells.kCount] = {};
    [[maybe_unused]] T value[F][8][cells.kCount];  // at the corners, for the slopes
    for (int k = 0; k < 8; ++k) {
#pragma GCC ivdep
      for (int64_t i = 0; i < size; ++i) {
        const auto e = load_entry<T, F>(table, cells.entry[k][i]);
        for (int f = 0; f < F; ++f) {
          sums[f][i] += cells.weight[k][i] * e.value[f];
          if constexpr (kSlopes) value[f][k][i] = e.value[f];
        }
      }
    }
    for (int f = 0; f < F; ++f) std::copy_n(sums[f], size, out + f * count + first);
    if constexpr (kSlopes) {
      for (int f = 0; f < F; ++f) {
        T* to = slopes + int64_t{3} * f * count + first;
#pragma GCC ivdep
        for (int64_t i = 0; i < size; ++i) {
          T v[8], sum[3];
          for (int k = 0; k < 8; ++k) v[k] = value[f][k][i];
          const T at[3] = {cells.fraction[0][i], cells.fraction[1][i], cells.fraction[2][i]};
          slope_of_cell(v, at, sum);
          for (int axis = 0; axis < 3; ++axis) to[axis * count + i] = sum[axis] * stretch;
        }
      }
    }
  }
}

/// Adds the sums of a cell's eight corners to the table; `sums` is [8, F].
template <typename T, int F>
TT3D_HD void add_cell(const uint32_t cell[3], const T* sums, T* grad_table,
                      const HashLevel& level) {
  for (int k = 0; k < 8; ++k) {
    T* entry = grad_table + static_cast<int64_t>(corner_entry(k, cell, level)) * F;
    for (int f = 0; f < F; ++f) entry[f] += sums[k * F + f];
  }
}

/// Coarse levels: neighbouring points (pixels of a surface, samples of a ray) lie in the same cell.
/// Its sums stay in registers until a point lies in another cell.
template <typename T, int F>
TT3D_HD void scatter_runs(const T* __restrict points, const T* __restrict grad_out,
                          T* __restrict grad_table, int64_t count, HashLevel level) {
  level.dense = true;
  uint32_t held[3] = {};
  T sums[8 * F] = {};
  for (int64_t i = 0; i < count; ++i) {
    T g[F];
    for (int f = 0; f < F; ++f) g[f] = grad_out[f * count + i];
    if (is_zero<T, F>(g)) continue;
    uint32_t cell[3];
    T fraction[3];
    for (int k = 0; k < 3; ++k) locate(points[3 * i + k], level, cell[k], fraction[k]);
    if (cell[0] != held[0] || cell[1] != held[1] || cell[2] != held[2]) {
      add_cell<T, F>(held, sums, grad_table, level);
      for (int k = 0; k < 8 * F; ++k) sums[k] = T(0);
      for (int k = 0; k < 3; ++k) held[k] = cell[k];
    }
    for (int k = 0; k < 8; ++k) {
      const T weight = corner_weight(k, fraction);
      for (int f = 0; f < F; ++f) sums[k * F + f] += weight * g[f];
    }
  }
  add_cell<T, F>(held, sums, grad_table, level);
}

/// Fine levels: nearly every point has its own cell.
template <typename T, int F>
TT3D_HD void scatter_blocks(const T* __restrict points, const T* __restrict grad_out,
                            T* __restrict grad_table, int64_t count, HashLevel level) {
  typedef T Numbers __attribute__((vector_size(sizeof(T) * F), aligned(sizeof(T)), may_alias));
  level.dense = false;
  Cells<T> cells;
  for (int64_t first = 0; first < count; first += cells.kCount) {
    const int64_t size = std::min(cells.kCount, count - first);
    cells.template find<F>(points + 3 * first, grad_table, size, level);
    cells.weigh(size);
    for (int64_t i = 0; i < size; ++i) {
      Numbers g;
      for (int f = 0; f < F; ++f) g[f] = grad_out[f * count + first + i];
      for (int k = 0; k < 8; ++k) {
        auto* numbers = reinterpret_cast<Numbers*>(grad_table);
        numbers[static_cast<int32_t>(cells.entry[k][i])] += cells.weight[k][i] * g;
      }
    }
  }
}

/// Gradient of points [begin, end), at most kSlopeChunk: sum over the rows of slope times gradient.
template <typename T>
TT3D_HD void slope_range(const T* __restrict points, const T* __restrict slopes,
                         const T* __restrict grad_out, T* __restrict grad_points, int64_t begin,
                         int64_t end, int64_t count, int64_t rows) {
  const int64_t size = end - begin;
  T total[3][kSlopeChunk] = {};
  for (int64_t r = 0; r < rows; ++r) {
    const T* g = grad_out + r * count + begin;
    for (int axis = 0; axis < 3; ++axis) {
      const T* slope = slopes + (3 * r + axis) * count + begin;
      for (int64_t i = 0; i < size; ++i) total[axis][i] += slope[i] * g[i];
    }
  }
  for (int64_t i = 0; i < size; ++i) {
    for (int axis = 0; axis < 3; ++axis) {
      const int64_t at = 3 * (begin + i) + axis;
      grad_points[at] = is_inside(points[at]) ? total[axis][i] : T(0);
    }
  }
}

template <typename T, int F, bool kSlopes>
TT3D_HD void encode_level(const T* points, const T* table, T* out, T* slopes, int64_t begin,
                          int64_t end, int64_t count, const HashLevel& level) {
  if (level.dense)
    encode_range<T, F, true, kSlopes>(points, table, out, slopes, begin, end, count, level);
  else
    encode_range<T, F, false, kSlopes>(points, table, out, slopes, begin, end, count, level);
}

// Macros, because target_clones does not apply to templates: one function per type and feature
// count.
#define TT3D_HASH_LOOPS(T, F)                                                          \
  TT3D_CPU_LOOP void encode_##T##F(const T* points, const T* table, T* out, T* slopes, \
                                   int64_t begin, int64_t end, int64_t count,          \
                                   const HashLevel& level) {                           \
    if (slopes != nullptr)                                                             \
      encode_level<T, F, true>(points, table, out, slopes, begin, end, count, level);  \
    else                                                                               \
      encode_level<T, F, false>(points, table, out, slopes, begin, end, count, level); \
  }                                                                                    \
  TT3D_CPU_LOOP void scatter_##T##F(const T* points, const T* grad_out, T* grad_table, \
                                    int64_t count, const HashLevel& level) {           \
    if (level.dense)                                                                   \
      scatter_runs<T, F>(points, grad_out, grad_table, count, level);                  \
    else                                                                               \
      scatter_blocks<T, F>(points, grad_out, grad_table, count, level);                \
  }
TT3D_HASH_LOOPS(float, 1)
TT3D_HASH_LOOPS(float, 2)
TT3D_HASH_LOOPS(double, 1)
TT3D_HASH_LOOPS(double, 2)
#undef TT3D_HASH_LOOPS

#define TT3D_SLOPE_LOOP(T)                                                                 \
  TT3D_CPU_LOOP void slope_loop(const T* points, const T* slopes, const T* grad_out,       \
                                T* grad_points, int64_t begin, int64_t end, int64_t count, \
                                int64_t rows) {                                            \
    slope_range<T>(points, slopes, grad_out, grad_points, begin, end, count, rows);        \
  }
TT3D_SLOPE_LOOP(float)
TT3D_SLOPE_LOOP(double)
#undef TT3D_SLOPE_LOOP

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

}  // namespace

template <typename T>
void hash_encode(const Cpu&, const T* points, const T* table, T* out, T* slopes, int64_t count,
                 const HashLevels& levels, int64_t features) {
  const auto encode = encode_loop<T>(features);
  const int64_t chunks = (count + kChunk - 1) / kChunk;
  // Levels outermost, so that the table of a thread's level stays in its cache.
  for_each_task(levels.count * chunks, [&](int64_t task) {
    const int64_t l = task / chunks, begin = task % chunks * kChunk;
    const HashLevel& level = levels.level[l];
    const int64_t row = l * features;
    encode(points, table + level.offset * features, out + row * count,
           slopes ? slopes + 3 * row * count : nullptr, begin, std::min(count, begin + kChunk),
           count, level);
  });
}

template <typename T>
void hash_encode_backward(const Cpu&, const T* points, const T* grad_out, T* grad_table,
                          int64_t count, const HashLevels& levels, int64_t features) {
  const auto scatter = scatter_loop<T>(features);
  // A thread takes whole levels, the fine ones first, since they cost the most.
  for_each_task(levels.count, [&](int64_t task) {
    const int64_t l = levels.count - 1 - task;
    const HashLevel& level = levels.level[l];
    T* grad_level = grad_table + level.offset * features;
    std::fill_n(grad_level, int64_t{level.size} * features, T(0));
    scatter(points, grad_out + l * features * count, grad_level, count, level);
  });
}

template <typename T>
void hash_encode_backward_points(const Cpu&, const T* points, const T* /*table*/, const T* slopes,
                                 const T* grad_out, T* grad_points, int64_t count,
                                 const HashLevels& levels, int64_t features) {
  for_each_chunk(count, kSlopeChunk, [&](int64_t begin, int64_t end) {
    slope_loop(points, slopes, grad_out, grad_points, begin, end, count, levels.count * features);
  });
}

#define TT3D_INSTANTIATE(T)                                                                     \
  template void hash_encode(const Cpu&, const T*, const T*, T*, T*, int64_t, const HashLevels&, \
                            int64_t);                                                           \
  template void hash_encode_backward(const Cpu&, const T*, const T*, T*, int64_t,               \
                                     const HashLevels&, int64_t);                               \
  template void hash_encode_backward_points(const Cpu&, const T*, const T*, const T*, const T*, \
                                            T*, int64_t, const HashLevels&, int64_t);
TT3D_INSTANTIATE(float)
TT3D_INSTANTIATE(double)
#undef TT3D_INSTANTIATE

}  // namespace tt3d::field
