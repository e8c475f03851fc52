#include <ATen/ATen.h>

#include "tt3d/image.h"

namespace tt3d::image {

using at::Tensor;

Tensor premultiplied(const Tensor& rgba) {
  const Tensor straight = rgba.to(at::kFloat) / 255;
  const Tensor alpha = straight.narrow(2, 3, 1);
  return at::cat({straight.narrow(2, 0, 3) * alpha, alpha}, 2);
}

Tensor over_background(const Tensor& rgba, const Tensor& background) {
  return rgba.narrow(-1, 0, 3) + (1 - rgba.narrow(-1, 3, 1)) * background;
}

}  // namespace tt3d::image
