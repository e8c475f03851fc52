#include "picture_ops.h"

#include <ATen/ATen.h>
#include <torch/csrc/autograd/custom_function.h>

#include <cmath>

#include "blur_cpu.h"
#include "place_math.h"
#include "tt3d/device.h"

namespace tt3d {
namespace {

using at::Tensor;
using torch::autograd::AutogradContext;
using torch::autograd::Function;
using torch::autograd::variable_list;

template <typename T>
attack::Placement<T> placement(const Tensor& maps, const Tensor& background, int64_t height,
                               int64_t width, int64_t size) {
  return {maps.const_data_ptr<T>(),
          background.const_data_ptr<T>(),
          background.size(3),
          height,
          width,
          size};
}

/// images [N,H,W,4].
struct PlaceOver : public Function<PlaceOver> {
  static Tensor forward(AutogradContext* ctx, const Tensor& images, const Tensor& maps,
                        const Tensor& background, int64_t size) {
    const int64_t n = images.size(0);
    Tensor out = at::empty({n, 3, size, size}, images.options());
    AT_DISPATCH_FLOATING_TYPES(images.scalar_type(), "place_over", [&] {
      const attack::PlacePixel<scalar_t> body = {
          images.const_data_ptr<scalar_t>(), out.mutable_data_ptr<scalar_t>(),
          placement<scalar_t>(maps, background, images.size(1), images.size(2), size)};
      on_device_of(images, [&](const auto& on) { for_each_pixel(on, n, body); });
    });
    ctx->save_for_backward({maps, background});
    ctx->saved_data["sizes"] = std::vector<int64_t>{images.size(1), images.size(2), size};
    return out;
  }
  static variable_list backward(AutogradContext* ctx, const variable_list& grads) {
    const variable_list saved = ctx->get_saved_variables();
    const auto sizes = ctx->saved_data["sizes"].toIntVector();
    const Tensor grad = grads[0].contiguous();
    Tensor grad_images = at::zeros({grad.size(0), sizes[0], sizes[1], 4}, grad.options());
    AT_DISPATCH_FLOATING_TYPES(grad.scalar_type(), "place_over_backward", [&] {
      const attack::PlaceBackwardPixel<scalar_t> body = {
          grad.const_data_ptr<scalar_t>(), grad_images.mutable_data_ptr<scalar_t>(),
          placement<scalar_t>(saved[0], saved[1], sizes[0], sizes[1], sizes[2])};
      on_device_of(grad, [&](const auto& on) { for_each_pixel(on, grad.size(0), body); });
    });
    return {grad_images, Tensor(), Tensor(), Tensor()};
  }
};

template <typename T>
attack::BlurInput<T> blur_input(const Tensor& planes, const Tensor& taps) {
  return {planes.const_data_ptr<T>(),      taps.const_data_ptr<T>(), taps.size(0) - 1,
          planes.size(0) * planes.size(1), planes.size(2),           planes.size(3)};
}

/// taps [radius + 1]: half of the kernel.
struct Blur : public Function<Blur> {
  static Tensor forward(AutogradContext* ctx, const Tensor& pictures_in, const Tensor& taps) {
    const Tensor pictures = pictures_in.contiguous(), out = at::empty_like(pictures);
    AT_DISPATCH_FLOATING_TYPES(out.scalar_type(), "gaussian_blur", [&] {
      attack::blur_cpu(blur_input<scalar_t>(pictures, taps), out.mutable_data_ptr<scalar_t>());
    });
    ctx->save_for_backward({taps});
    return out;
  }
  static variable_list backward(AutogradContext* ctx, const variable_list& grads) {
    const Tensor taps = ctx->get_saved_variables()[0];
    const Tensor grad = grads[0].contiguous(), out = at::empty_like(grad);
    AT_DISPATCH_FLOATING_TYPES(out.scalar_type(), "gaussian_blur_backward", [&] {
      attack::blur_backward_cpu(blur_input<scalar_t>(grad, taps), out.mutable_data_ptr<scalar_t>());
    });
    return {out, Tensor()};
  }
};

/// The GPU's way: two convolutions, each of one axis.
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

Tensor place_over(const Tensor& renderings, const Tensor& maps, const Tensor& background,
                  int64_t size) {
  const int64_t n = renderings.size(0), side = background.size(3);
  TORCH_CHECK(renderings.dim() == 4 && renderings.size(1) == 4, "renderings must be [N,4,H,W]");
  TORCH_CHECK(maps.sizes() == at::IntArrayRef({n, 2, 3}), "maps must be [N,2,3]");
  TORCH_CHECK(
      (side == 1 || side == size) && background.sizes() == at::IntArrayRef({n, 3, side, side}),
      "background must be [N,3,size,size] or [N,3,1,1]");
  check_same_device("place_over", {renderings, maps, background});
  const auto type = renderings.scalar_type();
  return PlaceOver::apply(renderings.permute({0, 2, 3, 1}).contiguous(), maps.to(type).contiguous(),
                          background.to(type).contiguous(), size);
}

Tensor gaussian_blur(const Tensor& pictures, double sigma) {
  const auto radius = static_cast<int64_t>(std::ceil(2 * sigma));
  const Tensor distance = at::arange(radius + 1, pictures.options());
  Tensor taps = (-(distance.square()) / (2 * sigma * sigma)).exp();
  taps = taps / (2 * taps.sum() - taps[0]);
  if (!pictures.is_cpu()) return blur_of_convolutions(pictures, taps);
  return Blur::apply(pictures, taps);
}

}  // namespace tt3d
