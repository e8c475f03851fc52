#pragma once

#include <cmath>
#include <cstdint>

#include "tt3d/device.h"

/// Body of texture: one look-up.
namespace tt3d::raster {

/// Bilinear footprint of a point in one mipmap level: four texels and their weights.
struct Footprint {
  int64_t texel[4];  ///< indices into the level, row-major
  double weight[4];
  double du[4], dv[4];  ///< d weight / d(u,v)
};

TT3D_HD int64_t wrap(int64_t i, int64_t n) {
  const int64_t r = i % n;
  return r < 0 ? r + n : r;
}

TT3D_HD Footprint footprint_of(double u, double v, int64_t height, int64_t width) {
  const double x = u * static_cast<double>(width) - 0.5;
  const double y = v * static_cast<double>(height) - 0.5;
  const double x_floor = floor(x), y_floor = floor(y);
  const double fx = x - x_floor, fy = y - y_floor;
  const int64_t x0 = wrap(static_cast<int64_t>(x_floor), width), x1 = wrap(x0 + 1, width);
  const int64_t y0 = wrap(static_cast<int64_t>(y_floor), height), y1 = wrap(y0 + 1, height);
  const auto w = static_cast<double>(width);
  const auto h = static_cast<double>(height);
  return {{y0 * width + x0, y0 * width + x1, y1 * width + x0, y1 * width + x1},
          {(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy},
          {-(1 - fy) * w, (1 - fy) * w, -fy * w, fy * w},
          {-(1 - fx) * h, -fx * h, (1 - fx) * h, fx * h}};
}

/// Mipmap level of a footprint whose longer side covers 2^level texels, from the screen-space
/// derivatives d = {du/dx, du/dy, dv/dx, dv/dy}; clamped to [0, levels - 1].
TT3D_HD double mip_level(const double d[4], int64_t height, int64_t width, int64_t levels) {
  const auto w = static_cast<double>(width);
  const auto h = static_cast<double>(height);
  const double along_x = d[0] * d[0] * w * w + d[2] * d[2] * h * h;
  const double along_y = d[1] * d[1] * w * w + d[3] * d[3] * h * h;
  const double longer = along_x > along_y ? along_x : along_y;
  if (!(longer > 1)) return 0;
  const double level = 0.5 * log2(longer);
  const auto last = static_cast<double>(levels - 1);
  return level < last ? level : last;
}

}  // namespace tt3d::raster
