#include <ATen/ATen.h>
#include <torch/csrc/autograd/custom_function.h>

#include <cmath>

#include "blur_cpu.h"
#include "tt3d/image.h"

namespace tt3d::image {
namespace {

using at::Tensor;
using torch::autograd::AutogradContext;
using torch::autograd::Function;
using torch::autograd::variable_list;

template <typename T>
BlurInput<T> blur_input(const Tensor& planes, const Tensor& taps) {
  return {planes.const_data_ptr<T>(),      taps.const_data_ptr<T>(), taps.size(0) - 1,
          planes.size(0) * planes.size(1), planes.size(2),           planes.size(3)};
}

/// taps [radius + 1]: the centre and one half of the kernel.
struct Blur : public Function<Blur> {
  static Tensor forward(AutogradContext* ctx, const Tensor& pictures_in, const Tensor& taps) {
    const Tensor pictures = pictures_in.contiguous();
    Tensor out = at::empty_like(pictures);
    AT_DISPATCH_FLOATING_TYPES(out.scalar_type(), "gaussian_blur", [&] {
      blur_cpu(blur_input<scalar_t>(pictures, taps), out.mutable_data_ptr<scalar_t>());
    });
    ctx->save_for_backward({taps});
    return out;
  }
  static variable_list backward(AutogradContext* ctx, const variable_list& grads) {
    const Tensor taps = ctx->get_saved_variables()[0];
    const Tensor grad = grads[0].contiguous(), out = at::empty_like(grad);
    AT_DISPATCH_FLOATING_TYPES(out.scalar_type(), "gaussian_blur_backward", [&] {
      blur_backward_cpu(blur_input<scalar_t>(grad, taps), out.mutable_data_ptr<scalar_t>());
    });
    return {out, Tensor()};
  }
};

/// On the GPU: two convolutions, one per axis.
Tensor blur_of_convolutions(const Tensor& pictures, const Tensor& taps) {
  const int64_t radius = taps.size(0) - 1, channels = pictures.size(1);
  const Tensor kernel = at::cat({taps.narrow(0, 1, radius).flip(0), taps});
  const Tensor padded = at::replication_pad2d(pictures, {radius, radius, radius, radius});
  const auto along = [&](const Tensor& x, at::IntArrayRef shape) {
    return at::conv2d(x, kernel.view(shape).repeat({channels, 1, 1, 1}), Tensor(),
                      at::IntArrayRef{1, 1}, at::IntArrayRef{0, 0}, at::IntArrayRef{1, 1},
                      channels);
  };
  return along(along(padded, {1, 1, 1, -1}), {1, 1, -1, 1});
}

}  // namespace

Tensor gaussian_blur(const Tensor& pictures, double sigma) {
  const auto radius = static_cast<int64_t>(std::ceil(2 * sigma));
  const Tensor distance = at::arange(radius + 1, pictures.options());
  Tensor taps = (-(distance.square()) / (2 * sigma * sigma)).exp();
  taps = taps / (2 * taps.sum() - taps[0]);
  if (!pictures.is_cpu()) return blur_of_convolutions(pictures, taps);
  return Blur::apply(pictures, taps);
}

}  // namespace tt3d::image
