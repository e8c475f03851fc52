#pragma once

#include <cstdint>
#include <cstring>
#include <type_traits>

#include "pixels_cpu.h"

/// Vectors of four numbers, for loops that the compiler does not vectorise by itself. Four doubles
/// fill an AVX2 register; four numbers are a vertex in clip space or a pixel of rast. Only inlined
/// functions take them as arguments, so the calling convention for vectors does not matter.
namespace tt3d::raster {

constexpr int kLanes = 4;

template <typename T>
struct RowOf {
  typedef T Type __attribute__((vector_size(kLanes * sizeof(T))));
};
template <typename T>
using Row = typename RowOf<T>::Type;

/// Integer type of the same size as T.
template <typename T>
using WholeAs = std::conditional_t<sizeof(T) == sizeof(int32_t), int32_t, int64_t>;

template <typename Vector, typename T>
TT3D_HD Vector load(const T* from) {
  Vector v;
  std::memcpy(&v, from, sizeof v);
  return v;
}

/// Whether any lane of a mask is set.
template <typename Mask>
TT3D_HD bool any(const Mask& mask) {
  typedef int64_t Pair __attribute__((vector_size(2 * sizeof(int64_t))));
  Pair either;
  if constexpr (sizeof(Mask) == sizeof(Pair)) {
    either = reinterpret_cast<Pair>(mask);
  } else {
    static_assert(sizeof(Mask) == 2 * sizeof(Pair));
    either = __builtin_shufflevector(mask, mask, 0, 1) | __builtin_shufflevector(mask, mask, 2, 3);
  }
  return (either[0] | either[1]) != 0;
}

/// Adds a vector to four numbers.
template <typename T>
TT3D_HD void add_row(T* to, const Row<T>& row) {
  const Row<T> sum = load<Row<T>>(to) + row;
  std::memcpy(to, &sum, sizeof sum);
}

/// Turns four rows of four numbers into four columns.
template <typename T>
TT3D_HD void transpose(Row<T> (&rows)[4]) {
  const Row<T> ab_xy = __builtin_shufflevector(rows[0], rows[1], 0, 4, 1, 5);
  const Row<T> ab_zw = __builtin_shufflevector(rows[0], rows[1], 2, 6, 3, 7);
  const Row<T> cd_xy = __builtin_shufflevector(rows[2], rows[3], 0, 4, 1, 5);
  const Row<T> cd_zw = __builtin_shufflevector(rows[2], rows[3], 2, 6, 3, 7);
  rows[0] = __builtin_shufflevector(ab_xy, cd_xy, 0, 1, 4, 5);
  rows[1] = __builtin_shufflevector(ab_xy, cd_xy, 2, 3, 6, 7);
  rows[2] = __builtin_shufflevector(ab_zw, cd_zw, 0, 1, 4, 5);
  rows[3] = __builtin_shufflevector(ab_zw, cd_zw, 2, 3, 6, 7);
}

/// Loads rows row_at(0) to row_at(3) of a matrix with four columns, transposed: one lane per row.
template <typename T, typename RowAt>
TT3D_HD void load_rows(const T* from, const RowAt& row_at, Row<T> (&rows)[kLanes]) {
  for (int j = 0; j < kLanes; ++j) {
    rows[j] = load<Row<T>>(from + 4 * static_cast<int64_t>(row_at(j)));
  }
  transpose<T>(rows);
}

template <typename T>
TT3D_HD Row<double> doubles(const Row<T>& v) {
  return __builtin_convertvector(v, Row<double>);
}

/// Four vertices in clip space, one per lane.
template <typename T>
TT3D_HD FlatVertex<Row<double>> load_vertices(const T* clip, const int32_t (&vertex)[kLanes]) {
  Row<T> rows[kLanes];
  load_rows(
      clip, [&](int j) TT3D_INLINE { return vertex[j]; }, rows);
  return {doubles<T>(rows[0]), doubles<T>(rows[1]), doubles<T>(rows[3])};
}

}  // namespace tt3d::raster
