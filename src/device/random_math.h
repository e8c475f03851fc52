#pragma once

#include "tt3d/kernel.h"
#include "tt3d/philox.h"

/// Bodies of the random tensors: one block of the stream, or one number.
namespace tt3d::device {

/// Elements 4 i to 4 i + 3 from block i.
struct UnitBlock {
  RandomKey key;
  float* out;
  int64_t count;
  TT3D_HD void operator()(int64_t i) const {
    const RandomBlock block = key.block(static_cast<uint64_t>(i));
    for (int k = 0; k < 4; ++k) {
      if (4 * i + k < count) out[4 * i + k] = unit_float(block.word[k]);
    }
  }
};

/// The same in [low, high).
struct RangeBlock {
  RandomKey key;
  float* out;
  int64_t count;
  double low, high;
  TT3D_HD void operator()(int64_t i) const {
    const RandomBlock block = key.block(static_cast<uint64_t>(i));
    for (int k = 0; k < 4; ++k) {
      if (4 * i + k < count) out[4 * i + k] = static_cast<float>(between(block.word[k], low, high));
    }
  }
};

/// A sum of four uniforms is near enough to a normal, and needs no logarithm.
struct NoiseItem {
  RandomKey key;
  float* out;
  uint64_t first;
  TT3D_HD void operator()(int64_t i) const {
    const uint64_t position = first + 2 * static_cast<uint64_t>(i);
    const RandomBlock block = key.block(position / 4);
    const auto k = static_cast<int>(position % 4);
    const uint32_t a = block.word[k];
    const uint32_t b = k < 3 ? block.word[k + 1] : key.block(position / 4 + 1).word[0];
    constexpr float kScale = 1.7320508F;  // 1 / sqrt(4 / 12)
    const auto sum = static_cast<float>((a & 0xFFFF) + (a >> 16) + (b & 0xFFFF) + (b >> 16));
    out[i] = (sum / 65536.0F - 2.0F) * kScale;
  }
};

}  // namespace tt3d::device
