#include <cmath>
#include <numbers>

#include "tt3d/core.h"

namespace tt3d {
namespace {

/// Finaliser of splitmix64: mixes seed and stream name into the key.
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
    : key_{mix(seed + 0x9E3779B97F4A7C15ULL) ^ hash_name(stream), step} {}

uint32_t Random::next() {
  if (used_ == 4) {
    block_ = key_.block(counter_++);
    used_ = 0;
  }
  return block_.word[used_++];
}

float Random::uniform() { return unit_float(next()); }

double Random::uniform(double low, double high) { return between(next(), low, high); }

double Random::normal() {
  const double u = (static_cast<double>(next()) + 1.0) * 0x1p-32;
  const double v = static_cast<double>(next()) * 0x1p-32;
  return std::sqrt(-2.0 * std::log(u)) * std::cos(2.0 * std::numbers::pi * v);
}

int64_t Random::index(int64_t n) {
  const uint32_t high = next();
  return index_below(high, next(), n);
}

}  // namespace tt3d
