#include "composite_math.h"
#include "field_cpu.h"

namespace tt3d::field {

template <typename T>
void composite_cpu(const T* densities, const T* colors, const T* steps, const int64_t* ray_begin,
                   T* out, int64_t rays, int64_t samples) {
  for_each_index(rays, [&](int64_t r) {
    composite_ray(densities, colors, steps, ray_begin[r], ray_begin[r + 1], samples, out + 4 * r);
  });
}

template <typename T>
void composite_backward_cpu(const T* densities, const T* colors, const T* steps,
                            const int64_t* ray_begin, const T* grad_out, T* grad_densities,
                            T* grad_colors, int64_t rays, int64_t samples) {
  for_each_index(rays, [&](int64_t r) {
    composite_ray_backward(densities, colors, steps, ray_begin[r], ray_begin[r + 1], samples,
                           grad_out + 4 * r, grad_densities, grad_colors);
  });
}

#define TT3D_INSTANTIATE(T)                                                                        \
  template void composite_cpu(const T*, const T*, const T*, const int64_t*, T*, int64_t, int64_t); \
  template void composite_backward_cpu(const T*, const T*, const T*, const int64_t*, const T*, T*, \
                                       T*, int64_t, int64_t);
TT3D_INSTANTIATE(float)
TT3D_INSTANTIATE(double)
#undef TT3D_INSTANTIATE

}  // namespace tt3d::field
