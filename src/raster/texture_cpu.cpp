#include <cmath>

#include "raster_cpu.h"
#include "texture_math.h"

namespace tt3d::raster {
namespace {

/// The two levels of a look-up and the share of the coarser one.
struct LevelBlend {
  int64_t fine, coarse;
  double share;
};

template <typename T>
LevelBlend blend_levels(const MipLevel<T>* levels, int64_t level_count, const T* derivatives,
                        int64_t i) {
  if (derivatives == nullptr) return {0, 0, 0.0};
  double d[4];
  for (int k = 0; k < 4; ++k) d[k] = static_cast<double>(derivatives[4 * i + k]);
  const double level = mip_level(d, levels[0].height, levels[0].width, level_count);
  const auto fine = static_cast<int64_t>(level);
  return {fine, std::min(fine + 1, level_count - 1), level - static_cast<double>(fine)};
}

}  // namespace

template <typename T>
void texture_cpu(const MipLevel<T>* levels, int64_t level_count, const T* uv, const T* derivatives,
                 const T* rast, T* out, const Sizes& s) {
  for_each_index(s.views * s.height * s.width, [&](int64_t i) {
    if (rast[4 * i + 3] == T(0)) return;
    const LevelBlend blend = blend_levels(levels, level_count, derivatives, i);
    for (int pass = 0; pass < 2; ++pass) {
      const double share = pass == 0 ? 1 - blend.share : blend.share;
      if (share == 0) continue;
      const MipLevel<T>& level = levels[pass == 0 ? blend.fine : blend.coarse];
      const Footprint f =
          footprint_of(static_cast<double>(uv[2 * i]), static_cast<double>(uv[2 * i + 1]),
                       level.height, level.width);
      for (int k = 0; k < 4; ++k) {
        const T weight = static_cast<T>(share * f.weight[k]);
        for (int64_t c = 0; c < s.channels; ++c) {
          out[i * s.channels + c] += weight * level.texels[f.texel[k] * s.channels + c];
        }
      }
    }
  });
}

/// Scatters into texels run on one thread, in pixel order; uv gradients ride along.
template <typename T>
void texture_backward_cpu(const MipLevel<T>* levels, int64_t level_count, const T* uv,
                          const T* derivatives, const T* rast, const T* grad_out, T* grad_uv,
                          const Sizes& s) {
  for (int64_t i = 0; i < s.views * s.height * s.width; ++i) {
    if (rast[4 * i + 3] == T(0)) continue;
    const LevelBlend blend = blend_levels(levels, level_count, derivatives, i);
    double du = 0, dv = 0;
    for (int pass = 0; pass < 2; ++pass) {
      const double share = pass == 0 ? 1 - blend.share : blend.share;
      if (share == 0) continue;
      const MipLevel<T>& level = levels[pass == 0 ? blend.fine : blend.coarse];
      const Footprint f =
          footprint_of(static_cast<double>(uv[2 * i]), static_cast<double>(uv[2 * i + 1]),
                       level.height, level.width);
      for (int k = 0; k < 4; ++k) {
        for (int64_t c = 0; c < s.channels; ++c) {
          const auto g = static_cast<double>(grad_out[i * s.channels + c]) * share;
          const int64_t texel = f.texel[k] * s.channels + c;
          du += g * f.du[k] * static_cast<double>(level.texels[texel]);
          dv += g * f.dv[k] * static_cast<double>(level.texels[texel]);
          if (level.grad) level.grad[texel] += static_cast<T>(g * f.weight[k]);
        }
      }
    }
    if (grad_uv) {
      grad_uv[2 * i] = static_cast<T>(du);
      grad_uv[2 * i + 1] = static_cast<T>(dv);
    }
  }
}

#define TT3D_INSTANTIATE(T)                                                                     \
  template void texture_cpu(const MipLevel<T>*, int64_t, const T*, const T*, const T*, T*,      \
                            const Sizes&);                                                      \
  template void texture_backward_cpu(const MipLevel<T>*, int64_t, const T*, const T*, const T*, \
                                     const T*, T*, const Sizes&);
TT3D_INSTANTIATE(float)
TT3D_INSTANTIATE(double)
#undef TT3D_INSTANTIATE

}  // namespace tt3d::raster
