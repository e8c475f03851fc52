#include <algorithm>

#include "place_math.h"
#include "tt3d/device.h"
#include "tt3d/scene.h"

namespace tt3d::attack {
namespace {

/// A pixel's four channels.
template <typename T>
struct FourOf {
  typedef T type __attribute__((vector_size(4 * sizeof(T)), aligned(sizeof(T)), may_alias));
};
template <typename T>
TT3D_HD auto& four_at(T* numbers) {
  return *reinterpret_cast<typename FourOf<T>::type*>(numbers);
}
template <typename T>
TT3D_HD const auto& four_at(const T* numbers) {
  return *reinterpret_cast<const typename FourOf<T>::type*>(numbers);
}

/// A run of pixels in a row. The positions are computed in vectors of pixels, the colours in
/// vectors of channels.
template <typename T>
struct RowPart {
  static constexpr int32_t kCount = 64;
  T weight[4][kCount];
  int32_t row[kCount], column[kCount], whole[kCount];
  T channels[4 * kCount];  ///< of each pixel, channels last

  TT3D_HD void find(const Placement<T>& placement, int64_t n, int64_t y, int64_t x, int32_t count) {
    const Placement<T> p = placement;
    const auto here = static_cast<int32_t>(y), first = static_cast<int32_t>(x);
#pragma GCC ivdep
    for (int32_t i = 0; i < count; ++i) {
      const Taps<T> taps = taps_of(p, n, here, first + i);
      for (int k = 0; k < 4; ++k) weight[k][i] = taps.weight[k];
      row[i] = taps.row;
      column[i] = taps.column;
      whole[i] = taps.whole;
    }
  }
  [[nodiscard]] TT3D_HD Taps<T> taps(int32_t i) const {
    return {
        row[i], column[i], {weight[0][i], weight[1][i], weight[2][i], weight[3][i]}, whole[i] != 0};
  }
  /// Index of the first tap of pixel i in its image.
  [[nodiscard]] TT3D_HD int64_t first_tap(const Placement<T>& p, int32_t i) const {
    return (row[i] * p.width + column[i]) * p.stride;
  }
};

template <typename T>
TT3D_HD void part_of_row(const PlacePixel<T>& body, RowPart<T>& part, int64_t n, int64_t at,
                         int32_t count) {
  const int64_t right = body.p.stride, below = body.p.width * right;
  const T* image = body.image(n);
  for (int32_t i = 0; i < count; ++i) {
    T* sum = part.channels + 4 * i;
    if (!part.whole[i]) {
      std::fill_n(sum, 4, T(0));
      body.look_up(n, part.taps(i), sum);
      continue;
    }
    const T* tap = image + part.first_tap(body.p, i);
    four_at(sum) = part.weight[0][i] * four_at(tap) + part.weight[1][i] * four_at(tap + right) +
                   part.weight[2][i] * four_at(tap + below) +
                   part.weight[3][i] * four_at(tap + below + right);
  }
#pragma GCC ivdep
  for (int32_t i = 0; i < count; ++i) body.put(n, at + i, part.channels + 4 * i);
}

template <typename T>
TT3D_HD void part_of_row(const PlaceBackwardPixel<T>& body, RowPart<T>& part, int64_t n, int64_t at,
                         int32_t count) {
#pragma GCC ivdep
  for (int32_t i = 0; i < count; ++i) body.take(n, at + i, part.channels + 4 * i);
  const int64_t right = body.p.stride, below = body.p.width * right;
  T* image = body.image(n);
  for (int32_t i = 0; i < count; ++i) {
    const T* grad = part.channels + 4 * i;
    if (!part.whole[i]) {
      body.add(n, part.taps(i), grad);
      continue;
    }
    T* tap = image + part.first_tap(body.p, i);
    four_at(tap) += part.weight[0][i] * four_at(grad);
    four_at(tap + right) += part.weight[1][i] * four_at(grad);
    four_at(tap + below) += part.weight[2][i] * four_at(grad);
    four_at(tap + below + right) += part.weight[3][i] * four_at(grad);
  }
}

template <typename Body>
TT3D_HD void placed_row(const Body& shared, int64_t n, int64_t row) {
  const Body body = shared;
  RowPart<std::remove_cvref_t<decltype(*body.p.map)>> part;
  for (int64_t x = 0; x < body.columns(); x += part.kCount) {
    const auto count = static_cast<int32_t>(std::min<int64_t>(part.kCount, body.columns() - x));
    part.find(body.p, n, row, x, count);
    part_of_row(body, part, n, row * body.columns() + x, count);
  }
}

template <typename Body>
TT3D_HD void plain_row(const Body& shared, int64_t n, int64_t row) {
  const Body body = shared;
  for (int64_t x = 0; x < body.columns(); ++x) body(n, row, x);
}

}  // namespace

// Pictures run in parallel and the pixels of one picture in order, so the sums have the same bytes
// with any number of threads. target_clones needs plain functions, so each body has one.
#define TT3D_EACH_PIXEL(ROW, BODY)                                             \
  TT3D_CPU_LOOP static void row_of(const BODY& body, int64_t n, int64_t row) { \
    ROW(body, n, row);                                                         \
  }                                                                            \
  template <>                                                                  \
  void for_each_pixel(const Cpu&, int64_t pictures, const BODY& body) {        \
    for_each_task(pictures, [&](int64_t n) {                                   \
      for (int64_t row = 0; row < body.rows(); ++row) row_of(body, n, row);    \
    });                                                                        \
  }
TT3D_EACH_PIXEL(placed_row, PlacePixel<float>)
TT3D_EACH_PIXEL(placed_row, PlacePixel<double>)
TT3D_EACH_PIXEL(placed_row, PlaceBackwardPixel<float>)
TT3D_EACH_PIXEL(placed_row, PlaceBackwardPixel<double>)
TT3D_EACH_PIXEL(plain_row, OverWhitePixel<float>)
TT3D_EACH_PIXEL(plain_row, OverWhitePixel<double>)
TT3D_EACH_PIXEL(plain_row, OverWhiteBackwardPixel<float>)
TT3D_EACH_PIXEL(plain_row, OverWhiteBackwardPixel<double>)
#undef TT3D_EACH_PIXEL

}  // namespace tt3d::attack
