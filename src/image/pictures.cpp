#include "tt3d/pictures.h"

#include <ATen/ATen.h>

#include "codec.h"
#include "tt3d/core.h"
#include "tt3d/input_files.h"

namespace tt3d::image {
namespace fs = std::filesystem;

namespace {

using at::Tensor;

/// Turns and mirrors [H,W,C] so that the side that `orientation` names comes to the top. From 5 on
/// rows and columns change places.
Tensor oriented(const Tensor& image, int orientation) {
  constexpr bool kFlipRows[] = {false, false, true, true, false, false, true, true};
  constexpr bool kFlipColumns[] = {false, true, true, false, false, true, true, false};
  const int index = orientation - 1;
  Tensor upright = orientation >= 5 ? image.transpose(0, 1) : image;
  if (kFlipRows[index]) upright = upright.flip({0});
  if (kFlipColumns[index]) upright = upright.flip({1});
  return upright.contiguous();
}

}  // namespace

bool is_picture_name(const fs::path& path) {
  return has_extension(path, {".png", ".jpg", ".jpeg", ".webp"});
}

std::vector<fs::path> list_pictures(const fs::path& folder) {
  return list_files(folder, {".png", ".jpg", ".jpeg", ".webp"});
}

Tensor read_upright_image(const fs::path& path) {
  const std::string bytes = read_file(path);
  return oriented(decode_image(bytes, path), exif_orientation(bytes));
}

LabelPicture read_label_picture(const fs::path& path) {
  const std::string bytes = read_file(path);
  if (is_png(bytes)) return decode_png_labels(bytes, path);
  return {decode_image(bytes, path), /*exact=*/false};
}

}  // namespace tt3d::image
