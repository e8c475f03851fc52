#pragma once

#include <cmath>
#include <cstdint>

#include "tt3d/kernel.h"
#include "tt3d/philox.h"

/// Bodies that make rays and the points where the density is evaluated: one item each.
namespace tt3d::field {

/// Length of a camera's record on the device: camera_to_world (row-major, 12), fx, fy, cx, cy,
/// width, and the index of its picture's first pixel among all pictures. A double holds these
/// integers exactly.
inline constexpr int64_t kCameraNumbers = 18;

/// The ray through the point (column, row) of the image plane, in pixels.
TT3D_HD void pixel_ray(const double* camera, double column, double row, float origin[3],
                       float direction[3]) {
  const double *m = camera, *pinhole = camera + 12;
  const double local[3] = {(column - pinhole[2]) / pinhole[0], -(row - pinhole[3]) / pinhole[1],
                           -1.0};
  double world[3], norm = 0;
  for (int64_t k = 0; k < 3; ++k) {
    world[k] = m[4 * k] * local[0] + m[4 * k + 1] * local[1] + m[4 * k + 2] * local[2];
    norm += world[k] * world[k];
  }
  for (int64_t k = 0; k < 3; ++k) {
    origin[k] = static_cast<float>(m[4 * k + 3]);
    direction[k] = static_cast<float>(world[k] / std::sqrt(norm));
  }
}

/// Straight alpha of 8 bits to premultiplied colour and alpha, as image::premultiplied does.
TT3D_HD void premultiply(const uint8_t rgba[4], float out[4]) {
  out[3] = static_cast<float>(rgba[3]) / 255.0F;
  for (int k = 0; k < 3; ++k) out[k] = static_cast<float>(rgba[k]) / 255.0F * out[3];
}

/// Body: ray r through a random pixel of the pool, and the pixel's target.
struct DrawRay {
  RandomKey key;
  const int32_t* pixels;      ///< row-major indices within the picture, view after view
  const int64_t* view_begin;  ///< [views + 1] into pixels
  int64_t views;
  const double* cameras;    ///< [views, kCameraNumbers]
  const uint8_t* pictures;  ///< [all pixels, 4], straight alpha
  float *origins, *directions, *targets;
  TT3D_HD void operator()(int64_t r) const {
    const RandomBlock block = key.block(static_cast<uint64_t>(r) / 2);
    const uint32_t high = r % 2 == 0 ? block.word[0] : block.word[2];
    const uint32_t low = r % 2 == 0 ? block.word[1] : block.word[3];
    const int64_t i = index_below(high, low, view_begin[views]);
    int64_t view = 0, above = views;  // the last view that begins at or before i
    while (above - view > 1) {
      const int64_t middle = (view + above) / 2;
      if (view_begin[middle] <= i)
        view = middle;
      else
        above = middle;
    }
    const double* camera = cameras + view * kCameraNumbers;
    const auto width = static_cast<int64_t>(camera[16]);
    const int64_t pixel = pixels[i], column = pixel % width, row = pixel / width;
    pixel_ray(camera, static_cast<double>(column) + 0.5, static_cast<double>(row) + 0.5,
              origins + 3 * r, directions + 3 * r);
    const uint8_t* photograph = pictures + 4 * (static_cast<int64_t>(camera[17]) + pixel);
    premultiply(photograph, targets + 4 * r);
  }
};

/// Body: ray i of the rows of a picture from row_begin on.
struct RowRay {
  double camera[kCameraNumbers];
  int64_t row_begin;
  float *origins, *directions;
  TT3D_HD void operator()(int64_t i) const {
    const auto width = static_cast<int64_t>(camera[16]);
    const int64_t column = i % width, row = row_begin + i / width;
    pixel_ray(camera, static_cast<double>(column) + 0.5, static_cast<double>(row) + 0.5,
              origins + 3 * i, directions + 3 * i);
  }
};

/// Body: a random point of a cell of the occupancy grid over [-1,1]^3.
struct CellPoint {
  RandomKey key;
  const int64_t* cells;  ///< flat indices over (z,y,x)
  int64_t size;
  float* points;
  TT3D_HD void operator()(int64_t i) const {
    const float width = 2.0F / static_cast<float>(size);
    const int64_t c = cells[i];
    const int64_t coordinate[3] = {c % size, c / size % size, c / size / size};
    const auto first = 3 * static_cast<uint64_t>(i);
    for (int k = 0; k < 3; ++k) {
      const uint32_t word = key.block((first + k) / 4).word[(first + k) % 4];
      points[3 * i + k] = -1 + width * (static_cast<float>(coordinate[k]) + unit_float(word));
    }
  }
};

}  // namespace tt3d::field
