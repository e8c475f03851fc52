#pragma once

#include "tt3d/kernel.h"
#include "tt3d/philox.h"

/// Bodies of the random tensors: one block or one number of the stream.
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

/// Elements 2 i and 2 i + 1 from block i. A sum of four uniform numbers approximates a normal one
/// without a logarithm.
struct NoiseBlock {
  RandomKey key;
  float* out;
  int64_t count;
  TT3D_HD static float normal(uint32_t a, uint32_t b) {
    constexpr float kScale = 1.7320508F;  // 1 / sqrt(4 / 12)
    const auto sum = static_cast<int32_t>((a & 0xFFFF) + (a >> 16) + (b & 0xFFFF) + (b >> 16));
    return (static_cast<float>(sum) / 65536.0F - 2.0F) * kScale;
  }
  TT3D_HD void pair(int64_t i, float& first, float& second) const {
    const RandomBlock block = key.block(static_cast<uint64_t>(i));
    first = normal(block.word[0], block.word[1]);
    second = normal(block.word[2], block.word[3]);
  }
  TT3D_HD void operator()(int64_t i) const {
    float first, second;
    pair(i, first, second);
    out[2 * i] = first;
    if (2 * i + 1 < count) out[2 * i + 1] = second;
  }
};

}  // namespace tt3d::device
