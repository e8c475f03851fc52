#pragma once

#include <algorithm>
#include <memory>
#include <type_traits>

#include "rasterize_math.h"
#include "tt3d/device.h"

namespace tt3d::raster {

/// Least pixels that are worth a thread.
constexpr int64_t kPixelsATask = 1024;

/// Calls visit(channels) with a number that the compiler knows where it is a usual one.
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

/// Of a function object within a loop: so that it is compiled for the loop's processor.
#define TT3D_INLINE __attribute__((always_inline))

/// Adds to sums that pixels share: of each group (say, a view) `rows` rows of `length` numbers.
/// Calls add(group, first, last, sums) for parts of each group's pixels. All but a group's first
/// part have sums of their own, which are added in their order, and the parts do not depend on the
/// threads: neither do the bytes of the result. Where there are more rows than pixels, clearing and
/// adding them would cost more than it saves; then a group is one part.
template <typename T, typename Add>
void scatter_in_parts(int64_t groups, int64_t pixels, int64_t rows, int64_t length, T* sums,
                      const Add& add) {
  constexpr int64_t kParts = 8;
  const int64_t count = rows * length;
  const int64_t parts = std::clamp<int64_t>(
      std::min(kParts / std::max<int64_t>(groups, 1), pixels / std::max<int64_t>(rows, 1)), 1,
      kParts);
  const auto others = std::make_unique_for_overwrite<T[]>(groups * (parts - 1) * count);
  for_each_task(groups * parts, [&](int64_t i) {
    const int64_t group = i / parts, part = i % parts;
    T* out = sums + group * count;
    if (part > 0) {
      out = others.get() + (group * (parts - 1) + part - 1) * count;
      std::fill_n(out, count, T{0});
    }
    add(group, part * pixels / parts, (part + 1) * pixels / parts, out);
  });
  if (parts == 1) return;
  at::parallel_for(0, groups * count, 1 << 14, [&](int64_t begin, int64_t end) {
    for (int64_t group = begin / count; group * count < end; ++group) {
      const int64_t first = std::max<int64_t>(begin - group * count, 0);
      const int64_t last = std::min(end - group * count, count);
      T* out = sums + group * count;
      const T* other = others.get() + group * (parts - 1) * count;
      for (int64_t part = 1; part < parts; ++part, other += count) {
        for (int64_t i = first; i < last; ++i) out[i] += other[i];
      }
    }
  });
}

}  // namespace tt3d::raster
