#include <ATen/ATen.h>

#include <algorithm>

#include "tt3d/image.h"
#include "tt3d/pictures.h"
#include "tt3d/scene.h"

namespace tt3d::scene {

using at::Tensor;

Backgrounds::Backgrounds(const std::string& text) {
  if (text == "white") {
    color_ = at::ones({3});
  } else if (text.size() == 7 && text[0] == '#' &&
             text.find_first_not_of("0123456789abcdefABCDEF", 1) == std::string::npos) {
    const auto channel = [&](size_t i) {
      return static_cast<float>(std::stoi(text.substr(i, 2), nullptr, 16)) / 255.0F;
    };
    color_ = at::tensor({channel(1), channel(3), channel(5)});
  } else if (std::filesystem::is_directory(text)) {
    photographs_ = image::list_pictures(text);
    decoded_.resize(photographs_.size());
    if (photographs_.empty()) throw InputError(text, "contains no PNG or JPEG for a background");
  } else {
    throw InputError("background '" + text +
                     "': expected white, #rrggbb or a folder of photographs");
  }
}

Tensor Backgrounds::photograph(size_t index) const {
  constexpr int64_t kKeptBytes = int64_t{256} << 20;
  if (decoded_[index].defined()) return decoded_[index];
  Tensor image = image::read_upright_image(photographs_[index]).narrow(2, 0, 3).contiguous();
  if (decoded_bytes_ + image.numel() <= kKeptBytes) {
    decoded_[index] = image;
    decoded_bytes_ += image.numel();
  }
  return image;
}

Tensor Backgrounds::draw(int64_t height, int64_t width, Random& random) const {
  if (photographs_.empty()) return color_.expand({height, width, 3});
  const auto pick = static_cast<size_t>(random.index(static_cast<int64_t>(photographs_.size())));
  Tensor image = photograph(pick);
  // Crop the centre to the frame's aspect ratio, then resize.
  const int64_t h = image.size(0), w = image.size(1);
  const int64_t crop_h = std::min(h, w * height / width), crop_w = std::min(w, h * width / height);
  image = image.narrow(0, (h - crop_h) / 2, crop_h).narrow(1, (w - crop_w) / 2, crop_w);
  image = image.to(at::kFloat) / 255;
  return at::_upsample_bilinear2d_aa(image.permute({2, 0, 1}).unsqueeze(0).contiguous(),
                                     {height, width}, false)
      .squeeze(0)
      .permute({1, 2, 0});
}

}  // namespace tt3d::scene
