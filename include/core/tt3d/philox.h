#pragma once

#include <cstdint>

/// The counter-based generator of tt3d::Random (Philox4x32-10; Salmon et al., "Parallel random
/// numbers: as easy as 1, 2, 3", SC 2011), as constant expressions. A kernel on any device can draw
/// any number of a stream without drawing the earlier ones.
namespace tt3d {

/// Four words of a stream.
struct RandomBlock {
  uint32_t word[4];
};

/// A stream of one step: word i is word i % 4 of block i / 4.
struct RandomKey {
  uint64_t key = 0;
  uint64_t step = 0;

  [[nodiscard]] constexpr RandomBlock block(uint64_t counter) const {
    uint32_t c0 = static_cast<uint32_t>(counter), c1 = static_cast<uint32_t>(counter >> 32);
    uint32_t c2 = static_cast<uint32_t>(step), c3 = static_cast<uint32_t>(step >> 32);
    auto k0 = static_cast<uint32_t>(key);
    auto k1 = static_cast<uint32_t>(key >> 32);
    for (int round = 0; round < 10; ++round) {
      const uint64_t p0 = uint64_t{0xD2511F53U} * c0;
      const uint64_t p1 = uint64_t{0xCD9E8D57U} * c2;
      c0 = static_cast<uint32_t>(p1 >> 32) ^ c1 ^ k0;
      c2 = static_cast<uint32_t>(p0 >> 32) ^ c3 ^ k1;
      c1 = static_cast<uint32_t>(p1);
      c3 = static_cast<uint32_t>(p0);
      k0 += 0x9E3779B9U;
      k1 += 0xBB67AE85U;
    }
    return {{c0, c1, c2, c3}};
  }
};

/// Uniform in [0,1), 24 bits.
constexpr float unit_float(uint32_t word) { return static_cast<float>(word >> 8) * 0x1p-24F; }

/// Uniform in [low, high), 32 bits.
constexpr double between(uint32_t word, double low, double high) {
  return low + (high - low) * (static_cast<double>(word) * 0x1p-32);
}

/// Uniform integer in [0, n); n > 0. `high` and `low` are the halves of 64 random bits.
constexpr int64_t index_below(uint32_t high, uint32_t low, int64_t n) {
  const uint64_t wide = (static_cast<uint64_t>(high) << 32) | low;
  return static_cast<int64_t>(wide % static_cast<uint64_t>(n));
}

}  // namespace tt3d
