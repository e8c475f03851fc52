#pragma once

#include <cmath>
#include <cstdint>

#include "tt3d/device.h"

/// Body of ray marching: one ray through the occupancy grid over [-1,1]^3.
namespace tt3d::field {

/// Cells a side of a coarse cell.
inline constexpr int64_t kCoarse = 8;

struct MarchGrid {
  const uint8_t* occupied;  ///< [G,G,G] over (z,y,x)
  const uint8_t* coarse;    ///< [G/8,G/8,G/8]: whether any of 8x8x8 cells is occupied
  int64_t size;
  float step, near_distance;
};

/// Range of the ray inside the box; false if it misses.
TT3D_HD bool box_range(const float o[3], const float d[3], float near_distance, float& begin,
                       float& end) {
  begin = near_distance;
  end = 1e30F;
  for (int k = 0; k < 3; ++k) {
    const float inverse = 1.0F / (d[k] == 0 ? 1e-20F : d[k]);
    const float a = (-1 - o[k]) * inverse, b = (1 - o[k]) * inverse;
    begin = fmaxf(begin, fminf(a, b));
    end = fminf(end, fmaxf(a, b));
  }
  return begin < end;
}

TT3D_HD int64_t cell_coordinate(float x, int64_t size) {
  const auto c = static_cast<int64_t>((x + 1.0F) * 0.5F * static_cast<float>(size));
  return c < 0 ? 0 : (c >= size ? size - 1 : c);
}

/// Distance along the ray to the border of the cell that holds point p.
TT3D_HD float cell_exit(const float p[3], const float d[3], const int64_t cell[3], int64_t size) {
  float exit = 1e30F;
  const float width = 2.0F / static_cast<float>(size);
  for (int k = 0; k < 3; ++k) {
    if (d[k] == 0) continue;
    const float border = -1.0F + width * static_cast<float>(cell[k] + (d[k] > 0 ? 1 : 0));
    exit = fminf(exit, (border - p[k]) / d[k]);
  }
  return exit;
}

/// Visits the middle of every step in an occupied cell: visit(point[3]).
template <typename Visit>
TT3D_HD void march_ray(const float o[3], const float d[3], float jitter, const MarchGrid& grid,
                       const Visit& visit) {
  float begin, end;
  if (!box_range(o, d, grid.near_distance, begin, end)) return;
  // Steps sit on a lattice along the ray, so skipping empty cells does not shift later samples.
  const float start = begin + jitter * grid.step;
  for (int64_t i = 0;;) {
    const float t = start + static_cast<float>(i) * grid.step;
    if (t >= end) return;
    const float p[3] = {o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2]};
    int64_t cell[3];
    const int64_t coarse_size = grid.size / kCoarse;
    for (int k = 0; k < 3; ++k) cell[k] = cell_coordinate(p[k], coarse_size);
    float skip = 0;
    if (!grid.coarse[(cell[2] * coarse_size + cell[1]) * coarse_size + cell[0]]) {
      skip = cell_exit(p, d, cell, coarse_size);
    } else {
      for (int k = 0; k < 3; ++k) cell[k] = cell_coordinate(p[k], grid.size);
      if (grid.occupied[(cell[2] * grid.size + cell[1]) * grid.size + cell[0]]) {
        visit(p);
      } else {
        skip = cell_exit(p, d, cell, grid.size);
      }
    }
    const auto steps = static_cast<int64_t>(std::ceil(skip / grid.step));
    i += steps > 1 ? steps : 1;
  }
}

}  // namespace tt3d::field
