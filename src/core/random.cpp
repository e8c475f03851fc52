#include <cmath>
#include <numbers>

#include "tt3d/core.h"

namespace tt3d {
namespace {

constexpr uint32_t kMultiplier0 = 0xD2511F53U;
constexpr uint32_t kMultiplier1 = 0xCD9E8D57U;
constexpr uint32_t kWeyl0 = 0x9E3779B9U;
constexpr uint32_t kWeyl1 = 0xBB67AE85U;

void philox(uint64_t key, uint64_t step, uint64_t counter, uint32_t out[4]) {
  uint32_t c[4] = {static_cast<uint32_t>(counter), static_cast<uint32_t>(counter >> 32),
                   static_cast<uint32_t>(step), static_cast<uint32_t>(step >> 32)};
  auto k0 = static_cast<uint32_t>(key);
  auto k1 = static_cast<uint32_t>(key >> 32);
  for (int round = 0; round < 10; ++round) {
    const uint64_t p0 = static_cast<uint64_t>(kMultiplier0) * c[0];
    const uint64_t p1 = static_cast<uint64_t>(kMultiplier1) * c[2];
    const uint32_t next[4] = {
        static_cast<uint32_t>(p1 >> 32) ^ c[1] ^ k0, static_cast<uint32_t>(p1),
        static_cast<uint32_t>(p0 >> 32) ^ c[3] ^ k1, static_cast<uint32_t>(p0)};
    for (int i = 0; i < 4; ++i) c[i] = next[i];
    k0 += kWeyl0;
    k1 += kWeyl1;
  }
  for (int i = 0; i < 4; ++i) out[i] = c[i];
}

/// Finaliser of splitmix64: spreads seed and stream over the key.
uint64_t mix(uint64_t x) {
  x ^= x >> 30;
  x *= 0xBF58476D1CE4E5B9ULL;
  x ^= x >> 27;
  x *= 0x94D049BB133111EBULL;
  return x ^ (x >> 31);
}

}  // namespace

uint64_t hash_name(std::string_view text) noexcept {
  uint64_t hash = 0xCBF29CE484222325ULL;
  for (const char c : text) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001B3ULL;
  return hash;
}

Random::Random(uint64_t seed, std::string_view stream, uint64_t step)
    : key_(mix(seed + 0x9E3779B97F4A7C15ULL) ^ hash_name(stream)), step_(step) {}

uint32_t Random::next() {
  if (used_ == 4) {
    philox(key_, step_, counter_++, block_);
    used_ = 0;
  }
  return block_[used_++];
}

float Random::uniform() { return static_cast<float>(next() >> 8) * 0x1p-24F; }

double Random::uniform(double low, double high) {
  return low + (high - low) * (static_cast<double>(next()) * 0x1p-32);
}

double Random::normal() {
  const double u = (static_cast<double>(next()) + 1.0) * 0x1p-32;
  const double v = static_cast<double>(next()) * 0x1p-32;
  return std::sqrt(-2.0 * std::log(u)) * std::cos(2.0 * std::numbers::pi * v);
}

int64_t Random::index(int64_t n) {
  const uint64_t wide = (static_cast<uint64_t>(next()) << 32) | next();
  return static_cast<int64_t>(wide % static_cast<uint64_t>(n));
}

}  // namespace tt3d
