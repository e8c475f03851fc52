#pragma once

#include <ATen/core/Tensor.h>

#include <filesystem>

namespace tt3d::capture {

/// Reads a mask file as the object's opacity, [H,W] uint8. White is the object and black the
/// background; grey levels between them are kept. Also read: labels (0 is the background, other
/// values are the object), coloured masks (black is the background), masks in an alpha channel, and
/// JPEG masks, which are thresholded. Throws InputError for pictures that are no mask.
[[nodiscard]] at::Tensor read_mask(const std::filesystem::path& path);

/// True if the object covers most of the border of a photograph with straight alpha, [H,W,4] uint8.
[[nodiscard]] bool object_at_border(const at::Tensor& rgba);

}  // namespace tt3d::capture
