#include "pixels_cpu.h"
#include "raster_kernels.h"
#include "rows_cpu.h"

namespace tt3d::raster {
namespace {

/// Derivatives for rows [first,last) of all views. Neighbouring pixels usually show the same
/// triangle.
template <typename T, typename Channels>
TT3D_HD void derive_rows(const AttributeDerivativesPixel<T>& body, int64_t first, int64_t last,
                         const Channels& channels) {
  const Sizes& s = body.s;
  const PixelSteps step(s);
  for (int64_t line = first; line < last; ++line) {
    const T* clip = body.clip + line / s.height * s.vertices * 4;
    const double py = pixel_y(line % s.height, s.height);
    BarycentricSlopes slopes = {};
    int64_t shown = -1;
    for (int64_t x = 0; x < s.width; ++x) {
      const int64_t i = line * s.width + x, face = body.face_at(i);
      if (face >= 0 && face != shown) slopes = barycentric_slopes(clip, body.faces + 3 * face);
      if (face >= 0) shown = face;
      body.write(i, face, slopes, pixel_x(x, s.width), py, step, channels);
    }
  }
}

/// Loads the first kCount numbers of a vector; the others are 0.
template <typename T, int64_t kCount>
TT3D_HD Row<T> load_first(const T* from) {
  if constexpr (kCount == kLanes) return load<Row<T>>(from);
  Row<T> v = {from[0], from[1]};
  if constexpr (sizeof(T) == sizeof(float)) {
    // One load for both numbers; the compiler does not combine two by itself.
    typedef int64_t Pairs __attribute__((vector_size(2 * sizeof(int64_t))));
    v = reinterpret_cast<Row<T>>(Pairs{load<int64_t>(from), 0});
  }
  for (int64_t k = 2; k < kCount; ++k) v[k] = from[k];
  return v;
}

/// Gradients of pixel i if a vertex's attributes fit into a vector: the same maths as the body's,
/// with vectors.
template <typename T, int64_t kChannels>
TT3D_HD void spread_short(const InterpolateBackwardPixel<T>& body, int64_t i,
                          const PartSums<T>& sums) {
  const int64_t face = body.face_at(i);
  if (face < 0) {
    if (body.grad_rast) body.set_grad_rast(i, face, kChannels);
    return;
  }
  const auto grad = load_first<T, kChannels>(body.grad_out + i * kChannels);
  const int32_t* corners = body.faces + 3 * face;
  const int32_t corner[3] = {corners[0], corners[1], corners[2]};
  if (body.grad_rast) {
    const auto attribute = [&](int k) TT3D_INLINE {
      return load_first<T, kChannels>(body.attributes + corner[k] * kChannels);
    };
    const Row<T> last = attribute(2);
    const Row<T> along_u = grad * (attribute(0) - last), along_v = grad * (attribute(1) - last);
    // Both sums at once.
    const Row<T> pairs = __builtin_shufflevector(along_u, along_v, 0, 4, 1, 5) +
                         __builtin_shufflevector(along_u, along_v, 2, 6, 3, 7);
    const Row<T> sum = pairs + __builtin_shufflevector(pairs, pairs, 2, 3, 0, 1);
    const Row<T> out = __builtin_shufflevector(sum, Row<T>{}, 0, 1, 4, 5);
    std::memcpy(body.grad_rast + 4 * i, &out, sizeof out);
  }
  if (!sums.rows) return;
  const T u = body.rast[4 * i], v = body.rast[4 * i + 1];
  sums.touch(corner[0], corner[1], corner[2]);
  add_row<T>(sums.rows + int64_t{kLanes} * corner[0], u * grad);
  add_row<T>(sums.rows + int64_t{kLanes} * corner[1], v * grad);
  add_row<T>(sums.rows + int64_t{kLanes} * corner[2], (1 - u - v) * grad);
}

/// The same for any number of channels.
template <typename T>
TT3D_HD void spread_long(const InterpolateBackwardPixel<T>& body, int64_t i,
                         const PartSums<T>& sums) {
  const int64_t face = body.face_at(i), channels = body.s.channels;
  if (body.grad_rast) body.set_grad_rast(i, face, channels);
  if (!sums.rows || face < 0) return;
  const T* grad = body.grad_out + i * channels;
  const int32_t* corner = body.faces + 3 * face;
  sums.touch(corner[0], corner[1], corner[2]);
  for (int k = 0; k < 3; ++k) {
    const T share = body.weight(i, k);
    T* out = sums.rows + corner[k] * channels;
    for (int64_t c = 0; c < channels; ++c) out[c] += share * grad[c];
  }
}

/// Adds the gradients of pixels [first,last) in pixel order; `sums` has no rows if the attributes
/// need no gradient. (The arguments are copies: the compiler knows that no write changes them, and
/// keeps them in registers.)
template <typename T>
TT3D_HD void spread_pixels(const InterpolateBackwardPixel<T> body, int64_t first, int64_t last,
                           const PartSums<T> sums) {
  with_channels(body.s.channels, [&](auto channels) TT3D_INLINE {
    for (int64_t i = first; i < last; ++i) {
      if constexpr (std::is_same_v<decltype(channels), int64_t>) {
        spread_long(body, i, sums);
      } else {
        spread_short<T, decltype(channels)::value>(body, i, sums);
      }
    }
  });
}

// Macros, because target_clones does not apply to templates.
#define TT3D_INTERPOLATE_LOOPS(T)                                                                \
  TT3D_CPU_LOOP void write_loop(const InterpolatePixel<T>& body, int64_t first, int64_t last) {  \
    with_channels(body.s.channels, [&](auto channels) TT3D_INLINE {                              \
      for (int64_t i = first; i < last; ++i) body.write(i, channels);                            \
    });                                                                                          \
  }                                                                                              \
  TT3D_CPU_LOOP void spread_loop(const InterpolateBackwardPixel<T>& body, int64_t first,         \
                                 int64_t last, const PartSums<T>& sums) {                        \
    spread_pixels(body, first, last, sums);                                                      \
  }                                                                                              \
  TT3D_CPU_LOOP void derive_loop(const AttributeDerivativesPixel<T>& body, int64_t first,        \
                                 int64_t last) {                                                 \
    with_channels(body.s.channels,                                                               \
                  [&](auto channels) TT3D_INLINE { derive_rows(body, first, last, channels); }); \
  }
TT3D_INTERPOLATE_LOOPS(float)
TT3D_INTERPOLATE_LOOPS(double)
#undef TT3D_INTERPOLATE_LOOPS

}  // namespace

template <typename T>
void for_each_pixel(const Cpu&, const InterpolatePixel<T>& body) {
  at::parallel_for(0, body.s.pixels(), kPixelsATask,
                   [&](int64_t first, int64_t last) { write_loop(body, first, last); });
}

template <typename T>
void for_each_pixel(const Cpu&, const AttributeDerivativesPixel<T>& body) {
  at::parallel_for(0, body.s.views * body.s.height, 1,
                   [&](int64_t first, int64_t last) { derive_loop(body, first, last); });
}

template <typename T>
void scatter(const Cpu&, const InterpolateBackwardPixel<T>& body) {
  if (!body.grad_attributes) {
    at::parallel_for(0, body.s.pixels(), kPixelsATask,
                     [&](int64_t first, int64_t last) { spread_loop(body, first, last, {}); });
    return;
  }
  const auto add = [&](int64_t /*group*/, int64_t first, int64_t last, const PartSums<T>& sums) {
    spread_loop(body, first, last, sums);
  };
  // With two or three channels a row is padded to a vector of four numbers (see with_channels).
  const int64_t channels = body.s.channels;
  const int64_t stride = channels == 2 || channels == 3 ? kLanes : channels;
  scatter_in_parts(1, body.s.pixels(), {body.s.vertices, channels, stride}, body.grad_attributes,
                   add);
}

#define TT3D_INSTANTIATE(T)                                                      \
  template void for_each_pixel(const Cpu&, const InterpolatePixel<T>&);          \
  template void for_each_pixel(const Cpu&, const AttributeDerivativesPixel<T>&); \
  template void scatter(const Cpu&, const InterpolateBackwardPixel<T>&);
TT3D_INSTANTIATE(float)
TT3D_INSTANTIATE(double)
#undef TT3D_INSTANTIATE

}  // namespace tt3d::raster
