#include <ATen/ATen.h>

#include "tt3d/image.h"

namespace tt3d::image {

using at::Tensor;

namespace {

/// [0,255] to [0,1], float32. The quotients come from the CPU: a GPU may round their last bit in
/// another way.
Tensor unit_range(const Tensor& bytes) {
  if (!bytes.is_cuda()) return bytes.to(at::kFloat) / 255;
  const Tensor quotients = (at::arange(256, at::kFloat) / 255).to(bytes.device());
  return quotients.index_select(0, bytes.flatten().to(at::kInt)).view_as(bytes);
}

}  // namespace

Tensor premultiplied(const Tensor& rgba) {
  const Tensor straight = unit_range(rgba);
  const Tensor alpha = straight.narrow(2, 3, 1);
  return at::cat({straight.narrow(2, 0, 3) * alpha, alpha}, 2);
}

Tensor over_background(const Tensor& rgba, const Tensor& background) {
  return rgba.narrow(-1, 0, 3) + (1 - rgba.narrow(-1, 3, 1)) * background;
}

}  // namespace tt3d::image
