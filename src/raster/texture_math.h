#pragma once

#include <cmath>
#include <cstdint>

#include "rasterize_math.h"

/// Bodies of texture: one look-up.
namespace tt3d::raster {

/// Bilinear footprint of a point in one mipmap level: four texels and their weights.
struct Footprint {
  int64_t texel[4];  ///< indices into the level, row-major
  double weight[4];
  double du[4], dv[4];  ///< d weight / d(u,v)
};

TT3D_HD int64_t wrap(int64_t i, int64_t n) {
  if (i >= 0 && i < n) return i;  // nearly always; a division costs as much as twenty additions
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

TT3D_HD float log2_of(float x) { return log2f(x); }
TT3D_HD double log2_of(double x) { return log2(x); }

/// Mipmap level of a footprint whose longer side covers 2^level texels. d = {du/dx, du/dy, dv/dx,
/// dv/dy} are the screen-space derivatives; clamped to [0, levels - 1].
template <typename T>
TT3D_HD double mip_level(const double d[4], int64_t height, int64_t width, int64_t levels) {
  const auto w = static_cast<double>(width);
  const auto h = static_cast<double>(height);
  const double along_x = d[0] * d[0] * w * w + d[2] * d[2] * h * h;
  const double along_y = d[1] * d[1] * w * w + d[3] * d[3] * h * h;
  const double longer = along_x > along_y ? along_x : along_y;
  if (!(longer > 1)) return 0;
  // Computed in the type of the texels: float costs half as much as double.
  const auto level = 0.5 * static_cast<double>(log2_of(static_cast<T>(longer)));
  const auto last = static_cast<double>(levels - 1);
  return level < last ? level : last;
}

/// One level of a mipmap chain.
template <typename T>
struct MipLevel {
  const T* texels;  ///< [height,width,C]
  T* grad;          ///< same shape, or null
  int64_t height, width;
};

/// A mipmap chain, small enough to be a kernel's argument: sides up to 2^23 texels.
template <typename T>
struct MipChain {
  static constexpr int64_t kMaxLevels = 24;
  MipLevel<T> level[kMaxLevels];
  int64_t count;
};

/// Body: each texel of a level is the mean of four texels of the finer level.
template <typename T>
struct HalveTexel {
  MipLevel<T> fine;
  T* coarse;
  int64_t channels;
  [[nodiscard]] TT3D_HD int64_t count() const { return (fine.height / 2) * (fine.width / 2); }
  TT3D_HD void operator()(int64_t i) const {
    const int64_t width = fine.width / 2, row = i / width;
    texel(row, i - row * width, channels);
  }
  TT3D_HD void texel(int64_t row, int64_t column, int64_t length) const {
    const T* above = fine.texels + 2 * (row * fine.width + column) * length;
    const T* below = above + fine.width * length;
    T* to = coarse + (row * (fine.width / 2) + column) * length;
    for (int64_t c = 0; c < length; ++c) {
      to[c] = T(0.25) * (above[c] + above[length + c] + below[c] + below[length + c]);
    }
  }
};

/// Body: spreads the gradient of each texel of a level over the four finer texels that it averaged.
template <typename T>
struct FoldTexel {
  MipLevel<T> fine;
  const T* coarse_grad;
  int64_t channels;
  [[nodiscard]] TT3D_HD int64_t count() const { return (fine.height / 2) * (fine.width / 2); }
  TT3D_HD void operator()(int64_t i) const {
    const int64_t width = fine.width / 2, row = i / width;
    texel(row, i - row * width, channels);
  }
  TT3D_HD void texel(int64_t row, int64_t column, int64_t length) const {
    T* above = fine.grad + 2 * (row * fine.width + column) * length;
    T* below = above + fine.width * length;
    const T* from = coarse_grad + (row * (fine.width / 2) + column) * length;
    for (int64_t c = 0; c < length; ++c) {
      const T share = T(0.25) * from[c];
      above[c] += share;
      above[length + c] += share;
      below[c] += share;
      below[length + c] += share;
    }
  }
};

/// The two levels of a look-up and the weight of the coarser one.
struct LevelBlend {
  int64_t fine, coarse;
  double share;
};

template <typename T>
TT3D_HD LevelBlend blend_levels(const MipChain<T>& levels, const T* derivatives, int64_t i) {
  if (derivatives == nullptr) return {0, 0, 0.0};
  double d[4];
  for (int k = 0; k < 4; ++k) d[k] = static_cast<double>(derivatives[4 * i + k]);
  const double level = mip_level<T>(d, levels.level[0].height, levels.level[0].width, levels.count);
  const auto fine = static_cast<int64_t>(level);
  const int64_t coarse = fine + 1 < levels.count ? fine + 1 : levels.count - 1;
  return {fine, coarse, level - static_cast<double>(fine)};
}

/// Writes every pixel.
template <typename T>
struct TexturePixel {
  MipChain<T> levels;
  const T* uv;
  const T* derivatives;  ///< null: no mipmaps
  const T* rast;
  T* out;
  Sizes s;
  TT3D_HD void operator()(int64_t i) const { write(i, s.channels); }
  TT3D_HD void write(int64_t i, int64_t channels) const {
    T* to = out + i * channels;
    for (int64_t c = 0; c < channels; ++c) to[c] = 0;
    if (rast[4 * i + 3] == T(0)) return;
    const LevelBlend blend = blend_levels(levels, derivatives, i);
    for (int pass = 0; pass < 2; ++pass) {
      const double share = pass == 0 ? 1 - blend.share : blend.share;
      if (share == 0) continue;
      const MipLevel<T>& level = levels.level[pass == 0 ? blend.fine : blend.coarse];
      const Footprint f =
          footprint_of(static_cast<double>(uv[2 * i]), static_cast<double>(uv[2 * i + 1]),
                       level.height, level.width);
      for (int64_t c = 0; c < channels; ++c) {
        T sum = to[c];
        for (int k = 0; k < 4; ++k) {
          sum += static_cast<T>(share * f.weight[k]) * level.texels[f.texel[k] * channels + c];
        }
        to[c] = sum;
      }
    }
  }
};

/// Adds to the levels' gradients and overwrites grad_uv, each if it is wanted.
template <typename T>
struct TextureBackwardPixel {
  MipChain<T> levels;
  const T* uv;
  const T* derivatives;
  const T* rast;
  const T* grad_out;
  T* grad_uv;  ///< may be null
  Sizes s;
  TT3D_HD void operator()(int64_t i) const { spread(i, s.channels); }
  TT3D_HD void spread(int64_t i, int64_t channels) const {
    if (rast[4 * i + 3] == T(0)) return;
    const LevelBlend blend = blend_levels(levels, derivatives, i);
    double du = 0, dv = 0;
    for (int pass = 0; pass < 2; ++pass) {
      const double share = pass == 0 ? 1 - blend.share : blend.share;
      if (share == 0) continue;
      const MipLevel<T>& level = levels.level[pass == 0 ? blend.fine : blend.coarse];
      const Footprint f =
          footprint_of(static_cast<double>(uv[2 * i]), static_cast<double>(uv[2 * i + 1]),
                       level.height, level.width);
      const T* g = grad_out + i * channels;
      if (level.grad) add_texels(level.grad, f, share, g, channels);
      for (int k = 0; grad_uv && k < 4; ++k) {
        const double along = share * along_texel(level.texels + f.texel[k] * channels, g, channels);
        du += along * f.du[k];
        dv += along * f.dv[k];
      }
    }
    if (!grad_uv) return;
    grad_uv[2 * i] = static_cast<T>(du);
    grad_uv[2 * i + 1] = static_cast<T>(dv);
  }

  TT3D_HD static void add_texels(T* grad, const Footprint& f, double share, const T* g,
                                 int64_t channels) {
    for (int64_t c = 0; c < channels; ++c) {
      const T along = g[c];
      for (int k = 0; k < 4; ++k) {
        accumulate(grad + f.texel[k] * channels + c, static_cast<T>(share * f.weight[k]) * along);
      }
    }
  }

  /// Dot product of the pixel's gradient and a texel's colour.
  TT3D_HD static double along_texel(const T* texel, const T* g, int64_t channels) {
    double sum = 0;
    for (int64_t c = 0; c < channels; ++c) {
      sum += static_cast<double>(g[c]) * static_cast<double>(texel[c]);
    }
    return sum;
  }
};

}  // namespace tt3d::raster
