#pragma once

#include <cmath>
#include <cstdint>

#include "tt3d/kernel.h"

/// Body of the nearest point search on the GPU: compares one query with all points. The CPU uses a
/// k-d tree.
namespace tt3d::mesh {

struct NearestPoint {
  const float* queries;  ///< [Q,3]
  const float* points;   ///< [count,3]
  int64_t count;
  const bool* own;  ///< [Q] true if the nearest point is known to have the query's own index
  int64_t* index;   ///< [Q] out; among equally near points the first
  TT3D_HD void operator()(int64_t i) const {
    int64_t found = i;
    float nearest = INFINITY;
    const float x = queries[3 * i], y = queries[3 * i + 1], z = queries[3 * i + 2];
    for (int64_t p = 0; p < (own[i] ? 0 : count); ++p) {
      const float dx = x - points[3 * p], dy = y - points[3 * p + 1], dz = z - points[3 * p + 2];
      const float squared = dx * dx + dy * dy + dz * dz;
      if (squared < nearest) {
        nearest = squared;
        found = p;
      }
    }
    index[i] = found;
  }
};

}  // namespace tt3d::mesh
