#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "patches.h"

namespace tt3d::asset {
namespace {

constexpr int64_t kGutter = 4;  ///< texels around packed pictures that repeat their edge

/// Places the pictures on shelves, tallest first; returns the total height and width.
std::array<int64_t, 2> place_patches(std::vector<Patch>& patches) {
  std::vector<size_t> order(patches.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) {
    return patches[a].image.size(0) > patches[b].image.size(0);
  });
  int64_t width = 0;
  double area = 0;
  for (const Patch& patch : patches) {
    const int64_t w = patch.image.size(1) + 2 * kGutter;
    width = std::max(width, w);
    area += static_cast<double>(w * (patch.image.size(0) + 2 * kGutter));
  }
  width = std::max(width, static_cast<int64_t>(std::ceil(std::sqrt(area))));
  int64_t x = 0, y = 0, shelf = 0;
  for (const size_t i : order) {
    const int64_t w = patches[i].image.size(1) + 2 * kGutter;
    if (x + w > width) {
      x = 0;
      y += shelf;
      shelf = 0;
    }
    patches[i].x = x + kGutter;
    patches[i].y = y + kGutter;
    x += w;
    shelf = std::max(shelf, patches[i].image.size(0) + 2 * kGutter);
  }
  return {y + shelf, width};
}

/// Copies a picture and repeats its edge in the gutter.
void paste(const Patch& patch, const at::Tensor& texture) {
  const auto indices = [](int64_t size) {
    return at::arange(-kGutter, size + kGutter, at::kLong).clamp(0, size - 1);
  };
  const int64_t height = patch.image.size(0), width = patch.image.size(1);
  const at::Tensor padded =
      patch.image.index_select(0, indices(height)).index_select(1, indices(width));
  texture.narrow(0, patch.y - kGutter, height + 2 * kGutter)
      .narrow(1, patch.x - kGutter, width + 2 * kGutter)
      .copy_(padded);
}

/// Keeps the texels along one axis that the faces use, and one more at each side.
void crop_axis(Patch& patch, size_t axis) {
  const int64_t dimension = axis == 0 ? 1 : 0;  // u runs along the columns
  const int64_t size = patch.image.size(dimension);
  double low = 1, high = 0;
  for (const auto& corners : patch.uvs) {
    for (const Uv& uv : corners) {
      low = std::min(low, uv[axis]);
      high = std::max(high, uv[axis]);
    }
  }
  const auto texels = static_cast<double>(size);
  const auto begin =
      std::clamp<int64_t>(static_cast<int64_t>(std::floor(low * texels)) - 1, 0, size - 1);
  const auto end =
      std::clamp<int64_t>(static_cast<int64_t>(std::ceil(high * texels)) + 1, begin + 1, size);
  patch.image = patch.image.narrow(dimension, begin, end - begin);
  for (auto& corners : patch.uvs) {
    for (Uv& uv : corners) {
      uv[axis] =
          (uv[axis] * texels - static_cast<double>(begin)) / static_cast<double>(end - begin);
    }
  }
}

bool is_too_large(const std::array<int64_t, 2>& size) {
  return size[0] > kMaxSide || size[1] > kMaxSide;
}

}  // namespace

at::Tensor pack_patches(std::vector<Patch>& patches, const std::filesystem::path& asset) {
  std::array<int64_t, 2> size = place_patches(patches);
  if (is_too_large(size)) {
    for (Patch& patch : patches) {
      crop_axis(patch, 0);
      crop_axis(patch, 1);
    }
    size = place_patches(patches);
  }
  const auto [height, width] = size;
  if (is_too_large(size)) {
    throw InputError(asset, "its textures together are larger than " + std::to_string(kMaxSide) +
                                " texels; shrink them");
  }
  at::Tensor texture = at::zeros({height, width, 3}, at::kByte);
  for (const Patch& patch : patches) paste(patch, texture);
  return texture;
}

}  // namespace tt3d::asset
