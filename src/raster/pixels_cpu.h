#pragma once

#include <algorithm>
#include <memory>
#include <type_traits>
#include <vector>

#include "rasterize_math.h"
#include "tt3d/device.h"

namespace tt3d::raster {

/// Smallest number of pixels worth a task of its own.
constexpr int64_t kPixelsATask = 1024;

/// Calls visit(channels); for the usual channel counts the argument is a compile-time constant.
template <typename Visit>
TT3D_HD void with_channels(int64_t channels, const Visit& visit) {
  switch (channels) {
    case 2:
      return visit(std::integral_constant<int64_t, 2>());
    case 3:
      return visit(std::integral_constant<int64_t, 3>());
    case 4:
      return visit(std::integral_constant<int64_t, 4>());
    default:
      return visit(channels);
  }
}

/// Force-inlines a lambda, so that it is compiled for the instruction set of the loop around it. A
/// macro, because compilers differ in the attribute's spelling.
#define TT3D_INLINE __attribute__((always_inline))

/// Layout of the sums that pixels share.
struct SumRows {
  int64_t count, length;
  int64_t stride;  ///< of a row while sums are added; at least the length
};

/// The sums of one part of the pixels. A part of a picture shows a part of the mesh, so rows are
/// cleared, and added to the result, only in blocks that the part touches.
template <typename T>
struct PartSums {
  static constexpr int64_t kBlock = 64;
  T* rows;
  uint8_t* touched;  ///< one flag per block
  int64_t stride;

  TT3D_HD static int64_t block_of(int32_t r) { return static_cast<uint32_t>(r) / kBlock; }
  /// Call it before adding to these rows.
  TT3D_HD void touch(int32_t a, int32_t b, int32_t c) const {
    const unsigned all = touched[block_of(a)] & touched[block_of(b)] & touched[block_of(c)];
    if (__builtin_expect(all == 0, 0)) clear(a), clear(b), clear(c);
  }
  __attribute__((noinline)) void clear(int32_t r) const {
    const int64_t block = block_of(r);
    if (touched[block] != 0) return;
    std::fill_n(rows + block * kBlock * stride, kBlock * stride, T{0});
    touched[block] = 1;
  }
};

/// Scatter-add with a deterministic result. Each group (e.g. a view) has its own rows of sums.
/// Calls add(group, first, last, part) for parts of each group's pixels; every part has its own
/// sums, which are then added in order. The parts do not depend on the number of threads, nor do
/// the result's bytes.
template <typename T, typename Add>
void scatter_in_parts(int64_t groups, int64_t pixels, const SumRows& rows, T* sums,
                      const Add& add) {
  constexpr int64_t kParts = 8, kBlock = PartSums<T>::kBlock;
  const int64_t parts = std::clamp<int64_t>(
      std::min(kParts / std::max<int64_t>(groups, 1), pixels / std::max<int64_t>(rows.count, 1)), 1,
      kParts);
  const int64_t blocks = (rows.count + kBlock - 1) / kBlock, size = blocks * kBlock * rows.stride;
  const auto memory = std::make_unique_for_overwrite<T[]>(groups * parts * size);
  std::vector<uint8_t> touched(groups * parts * blocks);
  for_each_task(groups * parts, [&](int64_t i) {
    const int64_t group = i / parts, part = i % parts;
    add(group, part * pixels / parts, (part + 1) * pixels / parts,
        PartSums<T>{memory.get() + i * size, touched.data() + i * blocks, rows.stride});
  });
  at::parallel_for(0, groups * blocks, 64, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      const int64_t group = i / blocks, block = i % blocks, first = block * kBlock;
      const int64_t last = std::min(first + kBlock, rows.count);
      for (int64_t p = group * parts; p < (group + 1) * parts; ++p) {
        if (touched[p * blocks + block] == 0) continue;
        const T* from = memory.get() + p * size;
        T* to = sums + group * rows.count * rows.length;
        for (int64_t r = first; r < last; ++r) {
          for (int64_t k = 0; k < rows.length; ++k) {
            to[r * rows.length + k] += from[r * rows.stride + k];
          }
        }
      }
    }
  });
}

}  // namespace tt3d::raster
