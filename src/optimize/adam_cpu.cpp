#include <algorithm>

#include "adam_cpu.h"
#include "tt3d/device.h"

namespace tt3d::optimize {
namespace {

constexpr int64_t kBlock = 16;  ///< a block of parameters is skipped if none has a gradient
constexpr int64_t kChunk = 1024 * kBlock;

TT3D_HD bool any_moves(const float* gradient, int64_t begin, int64_t end) {
  int moves = 0;
  for (int64_t i = begin; i < end; ++i) moves |= gradient[i] != 0.0F;
  return moves != 0;
}

TT3D_CPU_LOOP void step_range(const AdamEntry& body, int64_t begin, int64_t end) {
  const AdamEntry entry = body;
  for (int64_t b = begin; b < end; b += kBlock) {
    const int64_t stop = std::min(end, b + kBlock);
    if (!any_moves(entry.gradient, b, stop)) continue;
#pragma GCC ivdep
    for (int64_t i = b; i < stop; ++i) entry(i);
  }
}

}  // namespace

void for_each_index(const Cpu&, int64_t n, const AdamEntry& body) {
  for_each_chunk(n, kChunk, [&](int64_t begin, int64_t end) { step_range(body, begin, end); });
}

}  // namespace tt3d::optimize
