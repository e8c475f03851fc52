#pragma once

#include <cstdint>

/// CPU executors of the raster bodies: plain pointers in, plain pointers out. Gradients
/// accumulate into zeroed buffers. Every result has the same bytes with any number of threads:
/// each view's scatters run in pixel order on one thread.
namespace tt3d::raster {

/// Sizes shared by the operators.
struct Sizes {
  int64_t views, vertices, faces, height, width, channels;
};

template <typename T>
void rasterize_cpu(const T* clip, const int32_t* faces, T* rast, const Sizes& s);
template <typename T>
void rasterize_backward_cpu(const T* clip, const int32_t* faces, const T* rast, const T* grad_rast,
                            T* grad_clip, const Sizes& s);

template <typename T>
void interpolate_cpu(const T* attributes, const T* rast, const int32_t* faces, T* out,
                     const Sizes& s);
template <typename T>
void interpolate_backward_cpu(const T* attributes, const T* rast, const int32_t* faces,
                              const T* grad_out, T* grad_attributes, T* grad_rast, const Sizes& s);
template <typename T>
void attribute_derivatives_cpu(const T* attributes, const T* rast, const T* clip,
                               const int32_t* faces, T* out, const Sizes& s);

template <typename T>
void antialias_cpu(const T* color, const T* rast, const T* clip, const int32_t* faces,
                   const int32_t* opposites, T* out, const Sizes& s);
template <typename T>
void antialias_backward_cpu(const T* color, const T* rast, const T* clip, const int32_t* faces,
                            const int32_t* opposites, const T* grad_out, T* grad_color,
                            T* grad_clip, const Sizes& s);

/// One level of a mipmap chain.
template <typename T>
struct MipLevel {
  T* texels;  ///< [height,width,C]
  T* grad;    ///< same shape, or null
  int64_t height, width;
};
template <typename T>
void texture_cpu(const MipLevel<T>* levels, int64_t level_count, const T* uv, const T* derivatives,
                 const T* rast, T* out, const Sizes& s);
template <typename T>
void texture_backward_cpu(const MipLevel<T>* levels, int64_t level_count, const T* uv,
                          const T* derivatives, const T* rast, const T* grad_out, T* grad_uv,
                          const Sizes& s);

}  // namespace tt3d::raster
