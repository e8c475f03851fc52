#pragma once

#include <cmath>
#include <cstdint>

#include "tt3d/device.h"

/// Body of the hash encoding: one point in one level (Mueller et al. 2022, section 3).
namespace tt3d::field {

struct HashLevel {
  float scale;          ///< cells along the unit interval
  uint32_t resolution;  ///< grid points a side
  uint32_t size;        ///< entries
  bool dense;           ///< entries are grid points, no hashing
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

/// Entry of a grid point: its index when the level is dense, the paper's hash (eq. 4) otherwise.
TT3D_HD uint32_t entry_of(uint32_t x, uint32_t y, uint32_t z, const HashLevel& level) {
  if (level.dense) return x + level.resolution * (y + level.resolution * z);
  return (x ^ (y * 2654435761U) ^ (z * 805459861U)) & (level.size - 1U);
}

}  // namespace tt3d::field
