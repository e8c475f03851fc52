#pragma once

#include <cmath>
#include <cstdint>

#include "tt3d/kernel.h"

/// Bodies of ray marching through the occupancy grid over [-1,1]^3, and of the selection of
/// samples: one ray per item. Lists are made in two passes, count and write, with a prefix sum
/// between them.
namespace tt3d::field {

/// Side of a coarse cell, in cells.
inline constexpr int64_t kCoarse = 8;

struct MarchGrid {
  const uint8_t* occupied;  ///< [G,G,G] over (z,y,x)
  const uint8_t* coarse;    ///< [G/8,G/8,G/8]: whether any of the 8x8x8 cells is occupied
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

/// Calls visit(point[3]) for the middle of every step that lies in an occupied cell.
template <typename Visit>
TT3D_HD void march_ray(const float o[3], const float d[3], float jitter, const MarchGrid& grid,
                       const Visit& visit) {
  float begin, end;
  if (!box_range(o, d, grid.near_distance, begin, end)) return;
  // Steps lie on a lattice along the ray, so skipping empty cells does not shift later samples.
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

/// Body: whether any cell of 8x8x8 is occupied. Rays skip empty coarse cells as a whole.
struct CoarseCell {
  const uint8_t* occupied;
  uint8_t* coarse;
  int64_t size;  ///< of the fine grid, a multiple of 8
  TT3D_HD void operator()(int64_t i) const {
    const int64_t n = size / kCoarse;
    const int64_t x = i % n * kCoarse, y = i / n % n * kCoarse, z = i / n / n * kCoarse;
    uint8_t any = 0;
    for (int64_t dz = 0; dz < kCoarse; ++dz) {
      for (int64_t dy = 0; dy < kCoarse; ++dy) {
        const uint8_t* row = occupied + ((z + dz) * size + y + dy) * size + x;
        for (int64_t dx = 0; dx < kCoarse; ++dx) any |= row[dx];
      }
    }
    coarse[i] = any;
  }
};

/// Rays for marching, [R,3] each.
struct MarchRays {
  const float* origins;
  const float* directions;
  const float* jitter;
  MarchGrid grid;
};

struct CountSamples {
  MarchRays rays;
  int64_t* counts;  ///< [R+1]
  TT3D_HD void operator()(int64_t r) const {
    int64_t count = 0;
    march_ray(rays.origins + 3 * r, rays.directions + 3 * r, rays.jitter[r], rays.grid,
              [&](const float*) { ++count; });
    counts[r + 1] = count;
  }
};

struct WriteSamples {
  MarchRays rays;
  const int64_t* begin;
  float* points;
  TT3D_HD void operator()(int64_t r) const {
    float* next = points + 3 * begin[r];
    march_ray(rays.origins + 3 * r, rays.directions + 3 * r, rays.jitter[r], rays.grid,
              [&](const float* point) {
                for (int k = 0; k < 3; ++k) *next++ = point[k];
              });
  }
};

/// Body: the number of a ray's samples before an optical depth.
struct CountVisible {
  const float* densities;
  const float* steps;
  const int64_t* begin;
  double limit;
  int64_t* counts;  ///< [R+1]
  TT3D_HD void operator()(int64_t r) const {
    double depth = 0;
    int64_t i = begin[r];
    while (i < begin[r + 1] && depth < limit) {
      depth += static_cast<double>(densities[i] * steps[i]);
      ++i;
    }
    counts[r + 1] = i - begin[r];
  }
};

/// Body: the first samples of each ray, as many as its list has room for.
struct WriteFirst {
  const int64_t* begin;
  const int64_t* kept_begin;
  int64_t* kept;
  TT3D_HD void operator()(int64_t r) const {
    for (int64_t k = kept_begin[r]; k < kept_begin[r + 1]; ++k) {
      kept[k] = begin[r] + k - kept_begin[r];
    }
  }
};

/// A ray's samples in one round: the next `length` ones, while the ray is transparent.
struct RoundRange {
  const int64_t* begin;
  const double* depth;
  double limit;
  int64_t skip, length;  ///< samples per ray in earlier rounds, in this round
  TT3D_HD int64_t first(int64_t r) const { return begin[r] + skip; }
  TT3D_HD int64_t count(int64_t r) const {
    const int64_t left = begin[r + 1] - first(r);
    if (depth[r] >= limit || left <= 0) return 0;
    return left < length ? left : length;
  }
};

struct CountRound {
  RoundRange range;
  int64_t* counts;  ///< [R+1]
  TT3D_HD void operator()(int64_t r) const { counts[r + 1] = range.count(r); }
};

struct WriteRound {
  RoundRange range;
  const int64_t* chosen_begin;
  int64_t* chosen;
  TT3D_HD void operator()(int64_t r) const {
    const int64_t first = range.first(r);
    for (int64_t k = chosen_begin[r]; k < chosen_begin[r + 1]; ++k) {
      chosen[k] = first + k - chosen_begin[r];
    }
  }
};

/// Body: adds the optical depth of the round's samples to their ray.
struct AddRound {
  RoundRange range;
  const int64_t* chosen_begin;
  const float* densities;
  const float* steps;
  double* depth;
  TT3D_HD void operator()(int64_t r) const {
    const int64_t first = range.first(r), count = chosen_begin[r + 1] - chosen_begin[r];
    for (int64_t i = first; i < first + count; ++i) {
      depth[r] += static_cast<double>(densities[i] * steps[i]);
    }
  }
};

/// Body: copies a ray's direction to its samples.
struct RepeatDirection {
  const float* directions;  ///< [R,3]
  const int64_t* begin;
  float* out;  ///< [S,3]
  TT3D_HD void operator()(int64_t r) const {
    for (int64_t i = begin[r]; i < begin[r + 1]; ++i) {
      for (int k = 0; k < 3; ++k) out[3 * i + k] = directions[3 * r + k];
    }
  }
};

}  // namespace tt3d::field
