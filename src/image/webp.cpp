#include <ATen/ATen.h>
#include <webp/decode.h>

#include "codec.h"
#include "tt3d/core.h"

namespace tt3d::image {
namespace {

const uint8_t* data_of(std::string_view bytes) {
  return reinterpret_cast<const uint8_t*>(bytes.data());
}

WebPBitstreamFeatures features_of(std::string_view bytes, const std::filesystem::path& name) {
  WebPBitstreamFeatures features;
  if (WebPGetFeatures(data_of(bytes), bytes.size(), &features) != VP8_STATUS_OK) {
    throw InputError(name, "is not a valid WebP file");
  }
  return features;
}

}  // namespace

bool is_webp(std::string_view bytes) {
  return bytes.size() >= 12 && bytes.starts_with("RIFF") && bytes.substr(8, 4) == "WEBP";
}

bool webp_has_alpha(std::string_view bytes, const std::filesystem::path& name) {
  return features_of(bytes, name).has_alpha != 0;
}

at::Tensor decode_webp(std::string_view bytes, const std::filesystem::path& name) {
  const WebPBitstreamFeatures features = features_of(bytes, name);
  if (features.has_animation != 0) {
    throw InputError(name, "is an animated WebP; convert one of its pictures to PNG or JPEG");
  }
  check_image_size(features.width, features.height, name);
  at::Tensor image = at::empty({features.height, features.width, 4}, at::kByte);
  const int stride = 4 * features.width;
  if (WebPDecodeRGBAInto(data_of(bytes), bytes.size(), image.data_ptr<uint8_t>(), image.nbytes(),
                         stride) == nullptr) {
    throw InputError(name, "is a damaged or truncated WebP file");
  }
  return image;
}

}  // namespace tt3d::image
