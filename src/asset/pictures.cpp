#include <ATen/ATen.h>

#include <cmath>

#include "asset_source.h"
#include "tt3d/core.h"
#include "tt3d/image.h"

namespace tt3d::asset {

at::Tensor Pictures::decode(std::string_view bytes, const std::filesystem::path& name) {
  at::Tensor& image = decoded_[sha256(bytes)];
  if (!image.defined()) image = image::decode_image(bytes, name).narrow(2, 0, 3).contiguous();
  return image;
}

at::Tensor Pictures::tint(const at::Tensor& image, const std::array<double, 3>& factor) {
  if (factor[0] == 1 && factor[1] == 1 && factor[2] == 1) return image;
  at::Tensor& result = tinted_[{image.const_data_ptr(), factor}];
  if (result.defined()) return result;
  result = image.clone();
  uint8_t* pixels = result.data_ptr<uint8_t>();
  for (size_t c = 0; c < 3; ++c) {
    uint8_t table[256];
    for (int i = 0; i < 256; ++i) {
      const float linear = image::srgb_to_linear(static_cast<float>(i) / 255.F);
      const float tinted = image::linear_to_srgb(linear * static_cast<float>(factor[c]));
      table[i] = static_cast<uint8_t>(std::lround(tinted * 255.F));
    }
    for (int64_t i = static_cast<int64_t>(c); i < result.numel(); i += 3) {
      pixels[i] = table[pixels[i]];
    }
  }
  return result;
}

}  // namespace tt3d::asset
