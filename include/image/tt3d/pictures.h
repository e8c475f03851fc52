#pragma once

#include <ATen/core/Tensor.h>

#include <filesystem>
#include <string_view>
#include <vector>

/// Pictures as users have them: folders of photographs, photographs that lie on their side, and
/// pictures whose values are labels.
namespace tt3d::image {

/// True for the extensions .png, .jpg, .jpeg and .webp, in upper or lower case.
[[nodiscard]] bool is_picture_name(const std::filesystem::path& path);

/// The pictures of a folder, sorted by name, without hidden files. Throws InputError if the folder
/// cannot be read.
[[nodiscard]] std::vector<std::filesystem::path> list_pictures(const std::filesystem::path& folder);

/// The EXIF orientation of a JPEG or PNG, 1 to 8; 1 (upright) if the file gives none.
[[nodiscard]] int exif_orientation(std::string_view bytes);

/// Reads a picture like read_image and turns it upright as its EXIF orientation says. Not for
/// photographs with cameras: these refer to the pixels as stored.
[[nodiscard]] at::Tensor read_upright_image(const std::filesystem::path& path);

/// A picture whose values may be labels.
struct LabelPicture {
  at::Tensor rgba;    ///< [H,W,4] uint8, as from read_image
  bool exact = true;  ///< false for a JPEG, whose compression changes the values
  /// True for a 16-bit PNG with the largest value from 256 to 4095: too large for 8 bits, too dark
  /// for a picture of 16. `rgba` then holds the labels, those above 255 as 255.
  bool labels = false;
};
/// Reads a picture like read_image, but keeps the values of a 16-bit PNG without values above 4095.
/// read_image would divide them by 257.
[[nodiscard]] LabelPicture read_label_picture(const std::filesystem::path& path);

}  // namespace tt3d::image
