#pragma once

#include <cstdint>

#include "tt3d/kernel.h"

/// Bodies over a vertex and its neighbours, one vertex per item: sums in a fixed order, no atomics.
namespace tt3d::mesh {

/// The vertices' neighbour lists, stored one after another.
template <typename T>
struct NeighborLists {
  const int64_t* begin;   ///< [V+1]
  const int32_t* vertex;  ///< [2 E]
  const T* weight;        ///< [2 E], equal in both directions; null: all 1
  TT3D_HD T weight_of(int64_t k) const { return weight ? weight[k] : T(1); }
};

/// out[v] = sum over neighbours n of w (x[v] - x[n]): the graph Laplacian, which is symmetric.
template <typename T>
struct NeighborDifferences {
  NeighborLists<T> lists;
  const T* x;  ///< [V,3]
  T* out;      ///< [V,3]
  TT3D_HD void operator()(int64_t v) const {
    T sum[3] = {T(0), T(0), T(0)};
    for (int64_t k = lists.begin[v]; k < lists.begin[v + 1]; ++k) {
      const T* other = x + 3 * static_cast<int64_t>(lists.vertex[k]);
      for (int c = 0; c < 3; ++c) sum[c] += lists.weight_of(k) * (x[3 * v + c] - other[c]);
    }
    for (int c = 0; c < 3; ++c) out[3 * v + c] = sum[c];
  }
};

/// out[v] = sum over neighbours n of |x[v] - x[n]|^2, without weights.
template <typename T>
struct NeighborDistances {
  NeighborLists<T> lists;
  const T* x;  ///< [V,3]
  T* out;      ///< [V]
  TT3D_HD void operator()(int64_t v) const {
    T sum = T(0);
    for (int64_t k = lists.begin[v]; k < lists.begin[v + 1]; ++k) {
      const T* other = x + 3 * static_cast<int64_t>(lists.vertex[k]);
      for (int c = 0; c < 3; ++c) {
        const T difference = x[3 * v + c] - other[c];
        sum += difference * difference;
      }
    }
    out[v] = sum;
  }
};

}  // namespace tt3d::mesh
