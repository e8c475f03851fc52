#include "picture_ops.h"

#include <ATen/ATen.h>
#include <torch/csrc/autograd/custom_function.h>

#include "place_math.h"
#include "tt3d/device.h"

namespace tt3d::attack {
namespace {

using at::Tensor;
using torch::autograd::AutogradContext;
using torch::autograd::Function;
using torch::autograd::variable_list;

/// Renderings with channels last in memory. Consecutive pixels are `stride` numbers apart: four for
/// a picture of four channels, more if they are the first four channels of a wider picture.
struct PixelRows {
  explicit PixelRows(const Tensor& renderings) {
    const int64_t height = renderings.size(2), width = renderings.size(3);
    stride = width > 1 ? renderings.stride(3) : renderings.stride(2);
    tensor = renderings;
    if (renderings.strides() !=
        at::IntArrayRef({height * width * stride, 1, width * stride, stride})) {
      stride = renderings.size(1);
      tensor = renderings.contiguous(at::MemoryFormat::ChannelsLast);
    }
  }
  Tensor tensor;  ///< [N,4,H,W]
  int64_t stride;
};

/// [N,4,height,width], channels last in memory.
Tensor empty_renderings(int64_t count, int64_t height, int64_t width, const Tensor& like) {
  return at::empty({count, height, width, 4}, like.options()).permute({0, 3, 1, 2});
}

struct PlaceOver : public Function<PlaceOver> {
  static Tensor forward(AutogradContext* ctx, const Tensor& renderings, const Tensor& maps,
                        const Tensor& background, int64_t size) {
    const PixelRows rows(renderings);
    const int64_t n = renderings.size(0);
    Tensor out = at::empty({n, 3, size, size}, renderings.options());
    AT_DISPATCH_FLOATING_TYPES(out.scalar_type(), "place_over", [&] {
      const attack::PlacePixel<scalar_t> body = {
          rows.tensor.const_data_ptr<scalar_t>(), out.mutable_data_ptr<scalar_t>(),
          placement<scalar_t>(maps, background, rows.tensor, rows.stride, size)};
      on_device_of(out, [&](const auto& on) { for_each_pixel(on, n, body); });
    });
    ctx->save_for_backward({maps, background});
    ctx->saved_data["sizes"] = std::vector<int64_t>{renderings.size(2), renderings.size(3)};
    return out;
  }
  static variable_list backward(AutogradContext* ctx, const variable_list& grads) {
    const variable_list saved = ctx->get_saved_variables();
    const auto sizes = ctx->saved_data["sizes"].toIntVector();
    const Tensor grad = grads[0].contiguous();
    const Tensor grad_images = empty_renderings(grad.size(0), sizes[0], sizes[1], grad).zero_();
    AT_DISPATCH_FLOATING_TYPES(grad.scalar_type(), "place_over_backward", [&] {
      const attack::PlaceBackwardPixel<scalar_t> body = {
          grad.const_data_ptr<scalar_t>(), grad_images.mutable_data_ptr<scalar_t>(),
          placement<scalar_t>(saved[0], saved[1], grad_images, 4, grad.size(2))};
      on_device_of(grad, [&](const auto& on) { for_each_pixel(on, grad.size(0), body); });
    });
    return {grad_images, Tensor(), Tensor(), Tensor()};
  }

 private:
  template <typename T>
  static attack::Placement<T> placement(const Tensor& maps, const Tensor& background,
                                        const Tensor& renderings, int64_t stride, int64_t size) {
    return {maps.const_data_ptr<T>(),
            background.const_data_ptr<T>(),
            background.size(3),
            renderings.size(2),
            renderings.size(3),
            stride,
            size};
  }
};

struct OverWhite : public Function<OverWhite> {
  static Tensor forward(AutogradContext* /*ctx*/, const Tensor& renderings) {
    const PixelRows rows(renderings);
    const int64_t n = renderings.size(0), height = renderings.size(2), width = renderings.size(3);
    Tensor out = at::empty({n, 3, height, width}, renderings.options());
    AT_DISPATCH_FLOATING_TYPES(out.scalar_type(), "over_white", [&] {
      const attack::OverWhitePixel<scalar_t> body = {rows.tensor.const_data_ptr<scalar_t>(),
                                                     out.mutable_data_ptr<scalar_t>(), height,
                                                     width, rows.stride};
      on_device_of(out, [&](const auto& on) { for_each_pixel(on, n, body); });
    });
    return out;
  }
  static variable_list backward(AutogradContext* /*ctx*/, const variable_list& grads) {
    const Tensor grad = grads[0].contiguous();
    const int64_t n = grad.size(0), height = grad.size(2), width = grad.size(3);
    const Tensor grad_images = empty_renderings(n, height, width, grad);
    AT_DISPATCH_FLOATING_TYPES(grad.scalar_type(), "over_white_backward", [&] {
      const attack::OverWhiteBackwardPixel<scalar_t> body = {
          grad.const_data_ptr<scalar_t>(), grad_images.mutable_data_ptr<scalar_t>(), height, width};
      on_device_of(grad, [&](const auto& on) { for_each_pixel(on, n, body); });
    });
    return {grad_images};
  }
};

void check_renderings(const Tensor& renderings) {
  TORCH_CHECK(renderings.dim() == 4 && renderings.size(1) == 4, "renderings must be [N,4,H,W]");
}

}  // namespace

Tensor place_over(const Tensor& renderings, const Tensor& maps, const Tensor& background,
                  int64_t size) {
  const int64_t n = renderings.size(0), side = background.size(3);
  check_renderings(renderings);
  TORCH_CHECK(maps.sizes() == at::IntArrayRef({n, 2, 3}), "maps must be [N,2,3]");
  TORCH_CHECK(
      (side == 1 || side == size) && background.sizes() == at::IntArrayRef({n, 3, side, side}),
      "background must be [N,3,size,size] or [N,3,1,1]");
  check_same_device("place_over", {renderings, maps, background});
  const auto type = renderings.scalar_type();
  return PlaceOver::apply(renderings, maps.to(type).contiguous(), background.to(type).contiguous(),
                          size);
}

Tensor over_white(const Tensor& renderings) {
  check_renderings(renderings);
  return OverWhite::apply(renderings);
}

}  // namespace tt3d::attack
