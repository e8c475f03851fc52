#include <fmt/format.h>

#include <cmath>

#include "tt3d/model.h"

namespace tt3d::model {
namespace {

/// Python's round(), which torchvision's centre crop uses: ties go to the even number.
int64_t crop_start(int64_t size, int64_t crop) {
  return static_cast<int64_t>(std::nearbyint(static_cast<double>(size - crop) / 2.0));
}

at::Tensor resize(const at::Tensor& images, int64_t height, int64_t width,
                  const std::string& interpolation) {
  if (images.size(2) == height && images.size(3) == width) return images;
  if (interpolation == "bicubic") {
    // Cubic interpolation overshoots the range of a picture.
    return at::_upsample_bicubic2d_aa(images, {height, width}, false).clamp(0, 1);
  }
  return at::_upsample_bilinear2d_aa(images, {height, width}, false);
}

}  // namespace

at::Tensor preprocess(const at::Tensor& images, const ModelCard& card) {
  if (images.dim() != 4 || images.size(1) != 3 || images.scalar_type() != at::kFloat ||
      images.numel() == 0) {
    throw InputError(fmt::format("model {}: preprocess takes float32 images [N,3,h,w]", card.name));
  }
  const int64_t height = images.size(2), width = images.size(3);
  const int64_t shorter = std::min(height, width);
  const int64_t new_height = height * card.resize / shorter;
  const int64_t new_width = width * card.resize / shorter;
  const at::Tensor resized = resize(images, new_height, new_width, card.interpolation);
  const int64_t top = crop_start(new_height, card.height);
  const int64_t left = crop_start(new_width, card.width);
  return resized.slice(2, top, top + card.height).slice(3, left, left + card.width);
}

}  // namespace tt3d::model
