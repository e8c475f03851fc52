#pragma once

#include <ATen/core/Tensor.h>

#include <filesystem>
#include <string_view>

#include "tt3d/capture.h"

/// The decoders behind read_image: one file a format, each returns [H,W,4] uint8 and throws
/// InputError naming `name`.
namespace tt3d {

/// Images above this many pixels are refused (512 MiB as RGBA).
inline constexpr int64_t kMaxPixels = int64_t{1} << 27;

[[nodiscard]] bool is_png(std::string_view bytes);
[[nodiscard]] bool is_jpeg(std::string_view bytes);
[[nodiscard]] at::Tensor decode_png(std::string_view bytes, const std::filesystem::path& name);
[[nodiscard]] at::Tensor decode_jpeg(std::string_view bytes, const std::filesystem::path& name);
/// True if the PNG has an alpha channel or a tRNS chunk.
[[nodiscard]] bool png_has_alpha(std::string_view bytes, const std::filesystem::path& name);

/// Refuses empty images and those over kMaxPixels.
void check_image_size(int64_t width, int64_t height, const std::filesystem::path& name);

/// Refuses tensors that are not contiguous-able [H,W,C] uint8 with C in `channels`; returns the
/// tensor on the CPU, contiguous.
[[nodiscard]] at::Tensor check_encodable(const at::Tensor& image, std::string_view channels);

}  // namespace tt3d
