#pragma once

#include <cstdint>

namespace tt3d::image {

/// Planes to blur, and half of a symmetric kernel: tap[k] is the weight at distance k.
template <typename T>
struct BlurInput {
  const T* in;  ///< [planes,height,width]
  const T* tap;
  int64_t radius;
  int64_t planes, height, width;
};

/// out [planes,height,width]: blurred along both axes; border pixels are repeated outside.
template <typename T>
void blur_cpu(const BlurInput<T>& input, T* out);

/// The transpose of blur_cpu.
template <typename T>
void blur_backward_cpu(const BlurInput<T>& grad_out, T* grad_in);

}  // namespace tt3d::image
