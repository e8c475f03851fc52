#pragma once

#include "rasterize_math.h"

/// Bodies of interpolate and attribute_derivatives: one pixel.
namespace tt3d::raster {

/// The attribute rows of a triangle's three vertices.
template <typename T>
struct Corners {
  const T *a, *b, *c;
};

template <typename T>
TT3D_HD Corners<T> corners_of(const T* attributes, const int32_t* faces, int64_t face,
                              int64_t channels) {
  return {attributes + faces[3 * face] * channels, attributes + faces[3 * face + 1] * channels,
          attributes + faces[3 * face + 2] * channels};
}

/// Writes every pixel.
template <typename T>
struct InterpolatePixel {
  const T* attributes;
  const T* rast;
  const int32_t* faces;
  T* out;
  Sizes s;
  TT3D_HD void operator()(int64_t i) const { write(i, s.channels); }
  TT3D_HD void write(int64_t i, int64_t channels) const {
    T* to = out + i * channels;
    const auto face = static_cast<int64_t>(rast[4 * i + 3]) - 1;
    if (face < 0) {
      for (int64_t k = 0; k < channels; ++k) to[k] = 0;
      return;
    }
    const T u = rast[4 * i], v = rast[4 * i + 1];
    const Corners<T> p = corners_of(attributes, faces, face, channels);
    for (int64_t k = 0; k < channels; ++k) {
      to[k] = u * p.a[k] + v * p.b[k] + (1 - u - v) * p.c[k];
    }
  }
};

/// Overwrites grad_rast, where only u and v have a gradient, and adds to the attributes' gradients.
template <typename T>
struct InterpolateBackwardPixel {
  const T* attributes;
  const T* rast;
  const int32_t* faces;
  const T* grad_out;
  T* grad_attributes;  ///< may be null
  T* grad_rast;        ///< may be null
  Sizes s;
  /// The triangle at pixel i, -1 on the background.
  [[nodiscard]] TT3D_HD int64_t face_at(int64_t i) const {
    return static_cast<int64_t>(rast[4 * i + 3]) - 1;
  }
  /// Barycentric weight of a corner of the triangle at covered pixel i.
  [[nodiscard]] TT3D_HD T weight(int64_t i, int corner) const {
    const T u = rast[4 * i], v = rast[4 * i + 1];
    return corner == 0 ? u : corner == 1 ? v : 1 - u - v;
  }
  TT3D_HD void set_grad_rast(int64_t i, int64_t face, int64_t channels) const {
    const T* grad = grad_out + i * channels;
    T grad_u = 0, grad_v = 0;
    if (face >= 0) {
      const Corners<T> p = corners_of(attributes, faces, face, channels);
      for (int64_t k = 0; k < channels; ++k) {
        grad_u += grad[k] * (p.a[k] - p.c[k]);
        grad_v += grad[k] * (p.b[k] - p.c[k]);
      }
    }
    T* out = grad_rast + 4 * i;
    out[0] = grad_u;
    out[1] = grad_v;
    out[2] = 0;
    out[3] = 0;
  }
};

/// Writes every pixel.
template <typename T>
struct AttributeDerivativesPixel {
  const T* attributes;
  const T* rast;
  const T* clip;
  const int32_t* faces;
  T* out;
  Sizes s;
  TT3D_HD void operator()(int64_t i) const {
    const int64_t face = face_at(i);
    const PixelPlace at = place_of(i, s);
    BarycentricSlopes slopes = {};
    if (face >= 0) slopes = barycentric_slopes(clip + at.view * s.vertices * 4, faces + 3 * face);
    write(i, face, slopes, pixel_x(at.column, s.width), pixel_y(at.row, s.height), PixelSteps(s),
          s.channels);
  }
  /// The triangle at pixel i, -1 on the background.
  [[nodiscard]] TT3D_HD int64_t face_at(int64_t i) const {
    return static_cast<int64_t>(rast[4 * i + 3]) - 1;
  }
  TT3D_HD void write(int64_t i, int64_t face, const BarycentricSlopes& slopes, double px, double py,
                     const PixelSteps& step, int64_t channels) const {
    T* to = out + 2 * i * channels;
    if (face < 0) {
      for (int64_t k = 0; k < 2 * channels; ++k) to[k] = 0;
      return;
    }
    double d[4];
    barycentric_derivatives(slopes, px, py, step, d);
    const Corners<T> p = corners_of(attributes, faces, face, channels);
    for (int64_t k = 0; k < channels; ++k) {
      const auto along_u = static_cast<double>(p.a[k] - p.c[k]);
      const auto along_v = static_cast<double>(p.b[k] - p.c[k]);
      to[2 * k] = static_cast<T>(along_u * d[0] + along_v * d[2]);
      to[2 * k + 1] = static_cast<T>(along_u * d[1] + along_v * d[3]);
    }
  }
};

}  // namespace tt3d::raster
