#pragma once

#include <ATen/core/Tensor.h>

#include <filesystem>
#include <string_view>

#include "tt3d/image.h"
#include "tt3d/pictures.h"

/// The decoders of read_image, one file per format. Each returns [H,W,4] uint8 and throws
/// InputError that names `name`.
namespace tt3d::image {

/// Maximum number of pixels of an image (512 MiB as RGBA).
inline constexpr int64_t kMaxPixels = int64_t{1} << 27;

[[nodiscard]] bool is_png(std::string_view bytes);
[[nodiscard]] bool is_jpeg(std::string_view bytes);
[[nodiscard]] bool is_webp(std::string_view bytes);
[[nodiscard]] at::Tensor decode_png(std::string_view bytes, const std::filesystem::path& name);
[[nodiscard]] at::Tensor decode_jpeg(std::string_view bytes, const std::filesystem::path& name);
[[nodiscard]] at::Tensor decode_webp(std::string_view bytes, const std::filesystem::path& name);
/// True if the WebP has an alpha channel.
[[nodiscard]] bool webp_has_alpha(std::string_view bytes, const std::filesystem::path& name);
/// True if the PNG has an alpha channel or a tRNS chunk.
[[nodiscard]] bool png_has_alpha(std::string_view bytes, const std::filesystem::path& name);

/// Decodes a PNG for read_label_picture.
[[nodiscard]] LabelPicture decode_png_labels(std::string_view bytes,
                                             const std::filesystem::path& name);

/// Throws for empty images and those over kMaxPixels.
void check_image_size(int64_t width, int64_t height, const std::filesystem::path& name);

/// Throws unless the tensor is a non-empty [H,W,C] uint8 with C in `channels`; returns it
/// contiguous on the CPU.
[[nodiscard]] at::Tensor check_encodable(const at::Tensor& image, std::string_view channels);

}  // namespace tt3d::image
