#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>

/// Kernels of compiled convolutions that no library has: activation masks as bits, and depthwise
/// convolutions whose gradient takes such a mask along. All tensors are dense, on the CPU, float32
/// or bfloat16 (float64 in tests), and channels-last if they have four dimensions.
namespace tt3d::model {

/// The activation min(max(x, 0), high).
struct Clamp {
  bool active = false;
  double high = 0;  ///< infinite: relu
};

/// Bits of the elements of `result` in memory order, 1 where 0 < result < clamp.high: there the
/// slope of the activation is 1. uint8 [2 * ceil(n / 16)].
[[nodiscard]] at::Tensor slope_bits(const at::Tensor& result, const Clamp& clamp);

/// Sets the elements of `gradient` whose bit is 0 to zero.
void apply_bits(const at::Tensor& gradient, const at::Tensor& bits);

/// A depthwise convolution with square kernel, equal strides, zero padding and no dilation.
struct DepthwiseShape {
  int64_t channels = 0, kernel = 0, stride = 1;
  int64_t padding = 0;        ///< left and above
  int64_t padding_after = 0;  ///< right and below
};

/// True for the shapes that the kernels are made for: kernels of 3 and 5, strides 1 and 2,
/// channels a multiple of 16.
[[nodiscard]] bool has_depthwise_kernel(const DepthwiseShape& shape);

/// A depthwise convolution with its weights in the order of its loops.
class Depthwise {
 public:
  /// weight [C,1,k,k], bias [C] or undefined; their values are copied. Sums have the type `type`.
  Depthwise(const DepthwiseShape& shape, const at::Tensor& weight, const at::Tensor& bias,
            at::ScalarType type);

  /// x [N,C,H,W]; the clamped convolution. Fills `bits`, if not null, with its slope_bits.
  [[nodiscard]] at::Tensor forward(const at::Tensor& x, const Clamp& clamp, at::Tensor* bits) const;
  /// The gradient [N,C,height,width] of the input for that of the convolution, which is not masked.
  /// `input_bits`: if defined, the mask of the activation that gave the input, applied too.
  [[nodiscard]] at::Tensor backward(const at::Tensor& gradient, int64_t height, int64_t width,
                                    const at::Tensor& input_bits) const;
  /// True if the copies equal `weight` and `bias`.
  [[nodiscard]] bool holds(const at::Tensor& weight, const at::Tensor& bias) const;

 private:
  DepthwiseShape shape_;
  at::Tensor forward_weight_, backward_weight_, bias_;
};

}  // namespace tt3d::model
