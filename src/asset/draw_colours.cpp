#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>

#include "patches.h"
#include "tt3d/image.h"

namespace tt3d::asset {
namespace {

constexpr int64_t kSmallBlock = 4, kLargeBlock = 16, kMostBlock = 1024;  ///< sides, in texels
constexpr int64_t kMostTexels = int64_t{1} << 27;                        ///< of all blocks

using Rgb = std::array<float, 3>;

const std::array<float, 256>& linear_of_byte() {
  static const std::array<float, 256> table = [] {
    std::array<float, 256> values{};
    for (size_t i = 0; i < 256; ++i) {
      values[i] = image::srgb_to_linear(static_cast<float>(i) / 255.F);
    }
    return values;
  }();
  return table;
}

/// The texel that a coordinate outside the picture shows.
int64_t wrapped(int64_t i, int64_t size, Wrap wrap) {
  if (wrap == Wrap::kClamp) return std::clamp<int64_t>(i, 0, size - 1);
  const int64_t period = wrap == Wrap::kMirror ? 2 * size : size;
  const int64_t k = (i % period + period) % period;
  return k < size ? k : period - 1 - k;
}

/// Bilinear look-up in linear light.
Rgb sample(const SourceMaterial& material, const Uv& uv) {
  const int64_t height = material.image.size(0), width = material.image.size(1);
  const uint8_t* pixels = material.image.const_data_ptr<uint8_t>();
  constexpr double kFar = 1e9;  // keeps the texel's number in range
  const double x = std::clamp(uv[0] * static_cast<double>(width) - 0.5, -kFar, kFar);
  const double y = std::clamp(uv[1] * static_cast<double>(height) - 0.5, -kFar, kFar);
  const auto left = static_cast<int64_t>(std::floor(x)), top = static_cast<int64_t>(std::floor(y));
  const auto fx = static_cast<float>(x - std::floor(x)), fy = static_cast<float>(y - std::floor(y));
  Rgb sum{};
  for (int64_t dy = 0; dy < 2; ++dy) {
    for (int64_t dx = 0; dx < 2; ++dx) {
      const float weight = (dx == 1 ? fx : 1 - fx) * (dy == 1 ? fy : 1 - fy);
      const int64_t column = wrapped(left + dx, width, material.wrap_u);
      const int64_t row = wrapped(top + dy, height, material.wrap_v);
      for (int64_t c = 0; c < 3; ++c) {
        const uint8_t byte = pixels[3 * (row * width + column) + c];
        sum[static_cast<size_t>(c)] += weight * linear_of_byte()[byte];
      }
    }
  }
  return sum;
}

Rgb corner_colour(const AssetSource& source, const SourceFace& face, size_t k) {
  return source.colours[static_cast<size_t>(face.colours[k])];
}

/// Draws one face into its block. The corners lie on texel centres, and the texels beyond the
/// diagonal continue the gradient, so that bilinear look-ups interpolate as the vertex colours do.
void draw_block(const AssetSource& source, const SourceFace& face, int64_t side, uint8_t* out,
                int64_t pitch) {
  const auto steps = static_cast<float>(side - 1);
  const SourceMaterial& material = source.materials[static_cast<size_t>(face.material)];
  const std::array<Rgb, 3> colours = {corner_colour(source, face, 0),
                                      corner_colour(source, face, 1),
                                      corner_colour(source, face, 2)};
  const std::array<Uv, 3> uvs = {corner_uv(source, face, 0), corner_uv(source, face, 1),
                                 corner_uv(source, face, 2)};
  Rgb base = {image::srgb_to_linear(material.colour[0]), image::srgb_to_linear(material.colour[1]),
              image::srgb_to_linear(material.colour[2])};
  for (int64_t row = 0; row < side; ++row) {
    for (int64_t column = 0; column < side; ++column) {
      const float b = static_cast<float>(column) / steps;
      const float c = static_cast<float>(row) / steps;
      if (source.linear_colours && material.image.defined()) {
        base = sample(material, {(1 - b - c) * uvs[0][0] + b * uvs[1][0] + c * uvs[2][0],
                                 (1 - b - c) * uvs[0][1] + b * uvs[1][1] + c * uvs[2][1]});
      }
      for (size_t a = 0; a < 3; ++a) {
        const float value = std::clamp(
            (1 - b - c) * colours[0][a] + b * colours[1][a] + c * colours[2][a], 0.F, 1.F);
        const float shown = source.linear_colours ? image::linear_to_srgb(base[a] * value) : value;
        out[row * pitch + 3 * column + static_cast<int64_t>(a)] =
            static_cast<uint8_t>(std::lround(shown * 255.F));
      }
    }
  }
}

/// The side of a face's block. Linear colours far apart need more texels, because textures are
/// interpolated in sRGB; a texture needs as many as it has under the face.
int64_t side_of(const AssetSource& source, const SourceFace& face) {
  if (!source.linear_colours) return kSmallBlock;
  float apart = 0;
  for (size_t k = 0; k < 3; ++k) {
    const Rgb p = corner_colour(source, face, k), q = corner_colour(source, face, (k + 1) % 3);
    for (size_t a = 0; a < 3; ++a) apart = std::max(apart, std::abs(p[a] - q[a]));
  }
  int64_t side = apart > 0.1F ? kLargeBlock : kSmallBlock;
  const at::Tensor& image = source.materials[static_cast<size_t>(face.material)].image;
  if (!image.defined()) return side;
  const Uv first = corner_uv(source, face, 0);
  double texels = 0;
  for (size_t k = 1; k < 3; ++k) {
    const Uv uv = corner_uv(source, face, k);
    texels = std::max({texels, std::abs(uv[0] - first[0]) * static_cast<double>(image.size(1)),
                       std::abs(uv[1] - first[1]) * static_cast<double>(image.size(0))});
  }
  while (side < kMostBlock && static_cast<double>(side - 1) < texels) side *= 2;
  return side;
}

/// A square picture with a block for each of the faces.
Patch draw_blocks(const AssetSource& source, const std::vector<size_t>& faces, int64_t side) {
  Patch patch;
  patch.faces = faces;
  const auto count = static_cast<int64_t>(faces.size());
  const auto columns = static_cast<int64_t>(std::ceil(std::sqrt(static_cast<double>(count))));
  const int64_t rows = (count + columns - 1) / columns;
  const int64_t width = columns * side, height = rows * side;
  if (width > kMaxSide) {
    throw InputError(source.path,
                     "has too many vertex-coloured faces; bake the colours to a "
                     "texture");
  }
  patch.image = at::zeros({height, width, 3}, at::kByte);
  uint8_t* pixels = patch.image.data_ptr<uint8_t>();
  for (int64_t i = 0; i < count; ++i) {
    const int64_t x = i % columns * side, y = i / columns * side;
    draw_block(source, source.faces[faces[static_cast<size_t>(i)]], side,
               pixels + 3 * (y * width + x), 3 * width);
    const auto at = [&](int64_t dx, int64_t dy) {
      return Uv{(static_cast<double>(x + dx) + 0.5) / static_cast<double>(width),
                (static_cast<double>(y + dy) + 0.5) / static_cast<double>(height)};
    };
    patch.uvs.push_back({at(0, 0), at(side - 1, 0), at(0, side - 1)});
  }
  return patch;
}

}  // namespace

std::vector<Patch> draw_colours(const AssetSource& source, const std::vector<size_t>& faces) {
  std::map<int64_t, std::vector<size_t>> by_side;
  int64_t texels = 0;
  for (const size_t i : faces) {
    const int64_t side = side_of(source, source.faces[i]);
    by_side[side].push_back(i);
    texels += side * side;
  }
  // Shrink the largest blocks until all fit.
  while (texels > kMostTexels && by_side.rbegin()->first > kSmallBlock) {
    auto largest = by_side.extract(std::prev(by_side.end()));
    const int64_t side = largest.key() / 2;
    texels -= 3 * side * side * std::ssize(largest.mapped());
    std::vector<size_t>& smaller = by_side[side];
    smaller.insert(smaller.end(), largest.mapped().begin(), largest.mapped().end());
  }
  std::vector<Patch> patches;
  patches.reserve(by_side.size());
  for (const auto& [side, group] : by_side) patches.push_back(draw_blocks(source, group, side));
  return patches;
}

}  // namespace tt3d::asset
