#pragma once

#include <cstdint>

#include "tt3d/kernel.h"

/// Bodies of paint_pixels: one covered pixel.
namespace tt3d::raster {

/// Channel of alpha in a painted picture: after the three colours, before the other channels.
constexpr int64_t kAlpha = 3;

/// Channel of the picture for row c of the colours.
TT3D_HD int64_t painted_channel(int64_t c) { return c < kAlpha ? c : c + 1; }

template <typename T>
struct PaintPixel {
  const T* colors;        ///< [C,P]
  const int64_t* pixels;  ///< [P]
  T* picture;             ///< [pixels of all views, C + 1]
  int64_t channels, count;
  TT3D_HD void operator()(int64_t i) const {
    T* to = picture + pixels[i] * (channels + 1);
    for (int64_t c = 0; c < channels; ++c) to[painted_channel(c)] = colors[c * count + i];
    to[kAlpha] = T(1);
  }
};

template <typename T>
struct PaintBackwardPixel {
  const T* grad_picture;
  const int64_t* pixels;
  T* grad_colors;
  int64_t channels, count;
  TT3D_HD void operator()(int64_t i) const {
    const T* from = grad_picture + pixels[i] * (channels + 1);
    for (int64_t c = 0; c < channels; ++c) grad_colors[c * count + i] = from[painted_channel(c)];
  }
};

}  // namespace tt3d::raster
