#pragma once

#include <cmath>
#include <cstdint>

#include "tt3d/kernel.h"
#include "tt3d/scene.h"

/// Kernel bodies. Placement: one pixel of the transformed picture, sampled bilinearly from the
/// rendering and composited over its background. Over white: one pixel of a rendering.
namespace tt3d::attack {

/// Inputs of the placement.
template <typename T>
struct Placement {
  const T* map;         ///< [N,6]: coordinates of the picture to coordinates of the rendering, both
                        ///< [-1,1]
  const T* background;  ///< [N,3,side,side], with side = size or 1
  int64_t side;
  int64_t height, width;  ///< of the rendering
  int64_t stride;         ///< distance of consecutive pixels of the rendering, in numbers
  int64_t size;           ///< height and width of the picture

  /// Channel c of the background of picture n at pixel `at`.
  TT3D_HD T behind(int64_t n, int64_t c, int64_t at) const {
    return background[(n * 3 + c) * side * side + (side == 1 ? 0 : at)];
  }
};

/// The four pixels around a position and their weights, starting at the top left.
template <typename T>
struct Taps {
  int32_t row, column;
  T weight[4];
  bool whole;  ///< all four are inside the rendering
};

/// floor, inlined: on old processors std::floor is a function call.
template <typename T>
TT3D_HD T lower(T x) {
  const auto whole = static_cast<T>(static_cast<int32_t>(x));
  return whole > x ? whole - 1 : whole;
}

template <typename T>
TT3D_HD Taps<T> taps_of(const Placement<T>& p, int64_t n, int32_t row, int32_t column) {
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
  taps.row = static_cast<int32_t>(top);
  taps.column = static_cast<int32_t>(left);
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

/// One pixel of pictures [N,3,size,size], from renderings [N,height,width,stride]. The first four
/// numbers of a rendered pixel are its premultiplied colour and alpha.
template <typename T>
struct PlacePixel {
  const T* images;
  T* out;
  Placement<T> p;
  [[nodiscard]] TT3D_HD int64_t rows() const { return p.size; }
  [[nodiscard]] TT3D_HD int64_t columns() const { return p.size; }
  [[nodiscard]] TT3D_HD const T* image(int64_t n) const {
    return images + n * p.height * p.width * p.stride;
  }
  TT3D_HD void operator()(int64_t n, int64_t row, int64_t column) const {
    T sum[4] = {};
    look_up(n, taps_of(p, n, static_cast<int32_t>(row), static_cast<int32_t>(column)), sum);
    put(n, row * p.size + column, sum);
  }
  TT3D_HD void look_up(int64_t n, const Taps<T>& taps, T sum[4]) const {
    visit_taps(p, taps, [&](int64_t pixel, T weight) {
      for (int c = 0; c < 4; ++c) sum[c] += weight * image(n)[p.stride * pixel + c];
    });
  }
  TT3D_HD void put(int64_t n, int64_t at, const T sum[4]) const {
    const int64_t plane = p.size * p.size;
    for (int c = 0; c < 3; ++c) {
      out[(n * 3 + c) * plane + at] = sum[c] + (1 - sum[3]) * p.behind(n, c, at);
    }
  }
};

/// Adds the contribution of one pixel to the gradient of the renderings. Neighbouring pixels add to
/// the same values.
template <typename T>
struct PlaceBackwardPixel {
  const T* grad_out;
  T* grad_images;
  Placement<T> p;
  [[nodiscard]] TT3D_HD int64_t rows() const { return p.size; }
  [[nodiscard]] TT3D_HD int64_t columns() const { return p.size; }
  [[nodiscard]] TT3D_HD T* image(int64_t n) const {
    return grad_images + n * p.height * p.width * p.stride;
  }
  TT3D_HD void operator()(int64_t n, int64_t row, int64_t column) const {
    T grad[4];
    take(n, row * p.size + column, grad);
    add(n, taps_of(p, n, static_cast<int32_t>(row), static_cast<int32_t>(column)), grad);
  }
  TT3D_HD void take(int64_t n, int64_t at, T grad[4]) const {
    const int64_t plane = p.size * p.size;
    grad[3] = 0;
    for (int c = 0; c < 3; ++c) {
      grad[c] = grad_out[(n * 3 + c) * plane + at];
      grad[3] -= grad[c] * p.behind(n, c, at);
    }
  }
  TT3D_HD void add(int64_t n, const Taps<T>& taps, const T grad[4]) const {
    visit_taps(p, taps, [&](int64_t pixel, T weight) {
      for (int c = 0; c < 4; ++c) accumulate(image(n) + p.stride * pixel + c, weight * grad[c]);
    });
  }
};

/// One pixel of pictures [N,3,height,width]: renderings, in the layout of PlacePixel, over white.
template <typename T>
struct OverWhitePixel {
  const T* images;
  T* out;
  int64_t height, width, stride;
  [[nodiscard]] TT3D_HD int64_t rows() const { return height; }
  [[nodiscard]] TT3D_HD int64_t columns() const { return width; }
  TT3D_HD void operator()(int64_t n, int64_t row, int64_t column) const {
    const int64_t plane = height * width, at = row * width + column;
    const T* image = images + (n * plane + at) * stride;
    const T behind = 1 - image[3];
    for (int c = 0; c < 3; ++c) out[(n * 3 + c) * plane + at] = image[c] + behind;
  }
};

/// Overwrites grad_images [N,height,width,4].
template <typename T>
struct OverWhiteBackwardPixel {
  const T* grad_out;
  T* grad_images;
  int64_t height, width;
  [[nodiscard]] TT3D_HD int64_t rows() const { return height; }
  [[nodiscard]] TT3D_HD int64_t columns() const { return width; }
  TT3D_HD void operator()(int64_t n, int64_t row, int64_t column) const {
    const int64_t plane = height * width, at = row * width + column;
    T* grad = grad_images + (n * plane + at) * 4;
    T alpha = 0;
    for (int c = 0; c < 3; ++c) {
      grad[c] = grad_out[(n * 3 + c) * plane + at];
      alpha -= grad[c];
    }
    grad[3] = alpha;
  }
};

/// Pixel i of all pictures, in row-major order, for the GPU.
template <typename Body>
struct EachPixel {
  Body body;
  TT3D_HD void operator()(int64_t i) const {
    const int64_t columns = body.columns(), plane = body.rows() * columns;
    body(i / plane, i % plane / columns, i % columns);
  }
};

/// Runs a body on all pixels of `pictures` pictures. Instantiated for the bodies above, in float
/// and double.
template <typename Body>
void for_each_pixel(const Cpu&, int64_t pictures, const Body& body);

template <typename Body>
void for_each_pixel(const Cuda& on, int64_t pictures, const Body& body) {
  for_each_index(on, pictures * body.rows() * body.columns(), EachPixel<Body>{body});
}

}  // namespace tt3d::attack
