#pragma once

#include <cmath>
#include <cstdint>

#include "tt3d/kernel.h"

/// Bodies of the placement: a pixel of the transformed picture, looked up bilinearly in the
/// rendering, over its background.
namespace tt3d::attack {

/// Where a picture's pixels come from.
template <typename T>
struct Placement {
  const T* map;         ///< [N,6]: from the picture's to the rendering's coordinates, both [-1,1]
  const T* background;  ///< [N,3,side,side], side being size or 1
  int64_t side;
  int64_t height, width;  ///< of the rendering
  int64_t size;           ///< of the picture, both ways

  /// Channel c of picture n's background behind pixel `at`.
  TT3D_HD T behind(int64_t n, int64_t c, int64_t at) const {
    return background[(n * 3 + c) * side * side + (side == 1 ? 0 : at)];
  }
};

/// The four pixels around a place, from the top left one, and their weights.
template <typename T>
struct Taps {
  int64_t row, column;
  T weight[4];
  bool whole;  ///< all four lie in the rendering
};

/// floor, without the call that it is on old processors.
template <typename T>
TT3D_HD T lower(T x) {
  const auto whole = static_cast<T>(static_cast<int32_t>(x));
  return whole > x ? whole - 1 : whole;
}

template <typename T>
TT3D_HD Taps<T> taps_of(const Placement<T>& p, int64_t n, int64_t row, int64_t column) {
  const T* m = p.map + 6 * n;
  const T step = 2 / static_cast<T>(p.size);
  const T x = (static_cast<T>(column) + T(0.5)) * step - 1;
  const T y = (static_cast<T>(row) + T(0.5)) * step - 1;
  const T u = ((m[0] * x + m[1] * y + m[2] + 1) * static_cast<T>(p.width) - 1) / 2;
  const T v = ((m[3] * x + m[4] * y + m[5] + 1) * static_cast<T>(p.height) - 1) / 2;
  const T left = lower(u), top = lower(v), right = u - left, down = v - top;
  Taps<T> taps;
  taps.weight[0] = (1 - right) * (1 - down);
  taps.weight[1] = right * (1 - down);
  taps.weight[2] = (1 - right) * down;
  taps.weight[3] = right * down;
  taps.row = static_cast<int64_t>(top);
  taps.column = static_cast<int64_t>(left);
  taps.whole = left >= 0 && top >= 0 && left + 1 < static_cast<T>(p.width) &&
               top + 1 < static_cast<T>(p.height);
  return taps;
}

/// Calls visit(pixel, weight) for the taps inside the rendering.
template <typename T, typename Visit>
TT3D_HD void visit_taps(const Placement<T>& p, const Taps<T>& taps, const Visit& visit) {
  const int64_t first = taps.row * p.width + taps.column;
  for (int k = 0; k < 4; ++k) {
    const int64_t right = k & 1, down = k >> 1;
    const int64_t row = taps.row + down, column = taps.column + right;
    if (!taps.whole && (row < 0 || column < 0 || row >= p.height || column >= p.width)) continue;
    visit(first + down * p.width + right, taps.weight[k]);
  }
}

/// A pixel of pictures [N,3,size,size] from renderings [N,height,width,4], premultiplied.
template <typename T>
struct PlacePixel {
  const T* images;
  T* out;
  Placement<T> p;
  TT3D_HD void operator()(int64_t n, int64_t row, int64_t column) const {
    const int64_t plane = p.size * p.size, at = row * p.size + column;
    const Taps<T> taps = taps_of(p, n, row, column);
    const T* image = images + n * p.height * p.width * 4;
    T sum[4] = {};
    visit_taps(p, taps, [&](int64_t pixel, T weight) {
      for (int c = 0; c < 4; ++c) sum[c] += weight * image[4 * pixel + c];
    });
    for (int c = 0; c < 3; ++c) {
      out[(n * 3 + c) * plane + at] = sum[c] + (1 - sum[3]) * p.behind(n, c, at);
    }
  }
};

/// Adds a pixel's part of the renderings' gradient, which neighbours share.
template <typename T>
struct PlaceBackwardPixel {
  const T* grad_out;
  T* grad_images;
  Placement<T> p;
  TT3D_HD void operator()(int64_t n, int64_t row, int64_t column) const {
    const int64_t plane = p.size * p.size, at = row * p.size + column;
    T grad[4] = {};
    for (int c = 0; c < 3; ++c) {
      grad[c] = grad_out[(n * 3 + c) * plane + at];
      grad[3] -= grad[c] * p.behind(n, c, at);
    }
    const Taps<T> taps = taps_of(p, n, row, column);
    T* image = grad_images + n * p.height * p.width * 4;
    visit_taps(p, taps, [&](int64_t pixel, T weight) {
      for (int c = 0; c < 4; ++c) accumulate(image + 4 * pixel + c, weight * grad[c]);
    });
  }
};

/// Item i of all pictures' pixels, in row-major order, for the GPU.
template <typename Body>
struct EachPixel {
  Body body;
  TT3D_HD void operator()(int64_t i) const {
    const int64_t size = body.p.size, plane = size * size;
    body(i / plane, i % plane / size, i % size);
  }
};

/// All pixels of `pictures` pictures: pictures in parallel, the pixels of each in order, so that
/// sums get the same bytes with any number of threads.
void for_each_pixel(const Cpu&, int64_t pictures, const PlacePixel<float>& body);
void for_each_pixel(const Cpu&, int64_t pictures, const PlacePixel<double>& body);
void for_each_pixel(const Cpu&, int64_t pictures, const PlaceBackwardPixel<float>& body);
void for_each_pixel(const Cpu&, int64_t pictures, const PlaceBackwardPixel<double>& body);

template <typename Body>
void for_each_pixel(const Cuda& on, int64_t pictures, const Body& body) {
  for_each_index(on, pictures * body.p.size * body.p.size, EachPixel<Body>{body});
}

}  // namespace tt3d::attack
