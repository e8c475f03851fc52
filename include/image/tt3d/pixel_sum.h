#pragma once

#include <algorithm>
#include <cstdint>

namespace tt3d::image {

/// Weighted sum of premultiplied pixels: colours in 0..255 times alpha in 0..1.
struct PixelSum {
  float rgb[3] = {};
  float alpha = 0;
  void add(const uint8_t* pixel, float weight) {
    const float a = weight * static_cast<float>(pixel[3]) / 255.F;
    for (int c = 0; c < 3; ++c) rgb[c] += a * static_cast<float>(pixel[c]);
    alpha += a;
  }
  /// Stores the sum with straight alpha.
  void store(uint8_t* pixel) const {
    const float a = std::min(alpha, 1.F);
    pixel[3] = static_cast<uint8_t>(a * 255.F + 0.5F);
    for (int c = 0; c < 3; ++c) {
      const float straight = pixel[3] == 0 ? 0.F : rgb[c] / alpha;
      pixel[c] = static_cast<uint8_t>(std::clamp(straight, 0.F, 255.F) + 0.5F);
    }
  }
};

}  // namespace tt3d::image
