#include "raster_cpu.h"
#include "rasterize_math.h"

namespace tt3d::raster {

template <typename T>
void interpolate_cpu(const T* attributes, const T* rast, const int32_t* faces, T* out,
                     const Sizes& s) {
  for_each_index(s.views * s.height * s.width, [&](int64_t i) {
    const auto face = static_cast<int64_t>(rast[4 * i + 3]) - 1;
    if (face < 0) return;
    const T u = rast[4 * i], v = rast[4 * i + 1];
    const T* a = attributes + faces[3 * face] * s.channels;
    const T* b = attributes + faces[3 * face + 1] * s.channels;
    const T* c = attributes + faces[3 * face + 2] * s.channels;
    for (int64_t k = 0; k < s.channels; ++k) {
      out[i * s.channels + k] = u * a[k] + v * b[k] + (1 - u - v) * c[k];
    }
  });
}

namespace {

template <typename T>
void interpolate_backward_rast(const T* attributes, const T* rast, const int32_t* faces,
                               const T* grad_out, T* grad_rast, const Sizes& s) {
  for_each_index(s.views * s.height * s.width, [&](int64_t i) {
    const auto face = static_cast<int64_t>(rast[4 * i + 3]) - 1;
    if (face < 0) return;
    const T* a = attributes + faces[3 * face] * s.channels;
    const T* b = attributes + faces[3 * face + 1] * s.channels;
    const T* c = attributes + faces[3 * face + 2] * s.channels;
    T grad_u = 0, grad_v = 0;
    for (int64_t k = 0; k < s.channels; ++k) {
      const T g = grad_out[i * s.channels + k];
      grad_u += g * (a[k] - c[k]);
      grad_v += g * (b[k] - c[k]);
    }
    grad_rast[4 * i] = grad_u;
    grad_rast[4 * i + 1] = grad_v;
  });
}

/// Each thread owns a range of vertices and walks all pixels in order: no atomics, and the same
/// sums whatever the number of threads.
template <typename T>
void interpolate_backward_attributes(const T* rast, const int32_t* faces, const T* grad_out,
                                     T* grad_attributes, const Sizes& s) {
  const int64_t grain = std::max<int64_t>(1, s.vertices / std::max(1, at::get_num_threads()));
  at::parallel_for(0, s.vertices, grain, [&](int64_t first, int64_t last) {
    for (int64_t i = 0; i < s.views * s.height * s.width; ++i) {
      const auto face = static_cast<int64_t>(rast[4 * i + 3]) - 1;
      if (face < 0) continue;
      const T u = rast[4 * i], v = rast[4 * i + 1];
      const T weight[3] = {u, v, 1 - u - v};
      for (int c = 0; c < 3; ++c) {
        const int32_t vertex = faces[3 * face + c];
        if (vertex < first || vertex >= last) continue;
        T* out = grad_attributes + vertex * s.channels;
        for (int64_t k = 0; k < s.channels; ++k) out[k] += weight[c] * grad_out[i * s.channels + k];
      }
    }
  });
}

}  // namespace

template <typename T>
void interpolate_backward_cpu(const T* attributes, const T* rast, const int32_t* faces,
                              const T* grad_out, T* grad_attributes, T* grad_rast, const Sizes& s) {
  if (grad_rast) interpolate_backward_rast(attributes, rast, faces, grad_out, grad_rast, s);
  if (grad_attributes) {
    interpolate_backward_attributes(rast, faces, grad_out, grad_attributes, s);
  }
}

template <typename T>
void attribute_derivatives_cpu(const T* attributes, const T* rast, const T* clip,
                               const int32_t* faces, T* out, const Sizes& s) {
  for_each_index(s.views * s.height * s.width, [&](int64_t i) {
    const auto face = static_cast<int64_t>(rast[4 * i + 3]) - 1;
    if (face < 0) return;
    const int64_t n = i / (s.height * s.width);
    double d[4];
    barycentric_derivatives(clip + n * s.vertices * 4, faces + 3 * face,
                            pixel_x(i % s.width, s.width),
                            pixel_y(i / s.width % s.height, s.height), s.height, s.width, d);
    const T* a = attributes + faces[3 * face] * s.channels;
    const T* b = attributes + faces[3 * face + 1] * s.channels;
    const T* c = attributes + faces[3 * face + 2] * s.channels;
    for (int64_t k = 0; k < s.channels; ++k) {
      const double along_u = static_cast<double>(a[k] - c[k]);
      const double along_v = static_cast<double>(b[k] - c[k]);
      out[(i * s.channels + k) * 2] = static_cast<T>(along_u * d[0] + along_v * d[2]);
      out[(i * s.channels + k) * 2 + 1] = static_cast<T>(along_u * d[1] + along_v * d[3]);
    }
  });
}

#define TT3D_INSTANTIATE(T)                                                                    \
  template void interpolate_cpu(const T*, const T*, const int32_t*, T*, const Sizes&);         \
  template void interpolate_backward_cpu(const T*, const T*, const int32_t*, const T*, T*, T*, \
                                         const Sizes&);                                        \
  template void attribute_derivatives_cpu(const T*, const T*, const T*, const int32_t*, T*,    \
                                          const Sizes&);
TT3D_INSTANTIATE(float)
TT3D_INSTANTIATE(double)
#undef TT3D_INSTANTIATE

}  // namespace tt3d::raster
