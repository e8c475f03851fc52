#include <ATen/ATen.h>

#include "codec.h"
#include "tt3d/core.h"

namespace tt3d::image {

void check_image_size(int64_t width, int64_t height, const std::filesystem::path& name) {
  if (width <= 0 || height <= 0) throw InputError(name, "the image has no pixels");
  if (width * height > kMaxPixels) {
    throw InputError(name, "the image has " + std::to_string(width) + "x" + std::to_string(height) +
                               " pixels, over the limit of " + std::to_string(kMaxPixels) +
                               "; shrink it first");
  }
}

at::Tensor check_encodable(const at::Tensor& image, std::string_view channels) {
  const bool shaped =
      image.defined() && image.dim() == 3 && image.scalar_type() == at::kByte && image.numel() > 0;
  if (!shaped || channels.find(static_cast<char>('0' + image.size(2))) == channels.npos) {
    throw InputError("image to encode: expected a non-empty [H,W,C] uint8 tensor with C one of " +
                     std::string(channels));
  }
  return image.cpu().contiguous();
}

namespace {

/// The name of a format that is not read, by its first bytes; "" if unknown.
std::string other_format(std::string_view bytes) {
  using namespace std::string_view_literals;
  constexpr std::pair<std::string_view, const char*> kFormats[] = {
      {"\xABKTX 20"sv, "KTX2"}, {"DDS "sv, "DDS"},    {"GIF8"sv, "GIF"},
      {"BM"sv, "BMP"},          {"II*\0"sv, "TIFF"},  {"MM\0*"sv, "TIFF"},
      {"8BPS"sv, "Photoshop"},  {"v/1\x01"sv, "EXR"}, {"#?RADIANCE"sv, "HDR"}};
  for (const auto& [magic, name] : kFormats) {
    if (bytes.starts_with(magic)) return name;
  }
  return bytes.size() > 12 && bytes.substr(4, 4) == "ftyp" ? "HEIC or AVIF" : "";
}

}  // namespace

at::Tensor decode_image(std::string_view bytes, const std::filesystem::path& name) {
  if (bytes.empty())
    throw InputError(name, "the file is empty, expected a PNG, JPEG or WebP image");
  if (is_png(bytes)) return decode_png(bytes, name);
  if (is_jpeg(bytes)) return decode_jpeg(bytes, name);
  if (is_webp(bytes)) return decode_webp(bytes, name);
  const std::string format = other_format(bytes);
  throw InputError(name, "is " + (format.empty() ? "" : "a " + format + " file, ") +
                             "neither PNG nor JPEG nor WebP; convert the image to one of them");
}

at::Tensor read_image(const std::filesystem::path& path) {
  return decode_image(read_file(path), path);
}

bool image_has_alpha(const std::filesystem::path& path) {
  const std::string bytes = read_file(path);
  if (is_webp(bytes)) return webp_has_alpha(bytes, path);
  return is_png(bytes) && png_has_alpha(bytes, path);
}

at::Tensor to_uint8(const at::Tensor& image) {
  return (image.detach().clamp(0, 1) * 255).add(0.5).floor().to(at::kByte);
}

}  // namespace tt3d::image
