#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "asset_source.h"

// Several materials become one texture in three steps. First, every material gets a picture, and
// its faces get uvs within it (repeated textures are tiled, plain and vertex colours are drawn).
// Then the pictures are packed on shelves, and the uvs are adapted. A single plain texture is not
// changed.

namespace tt3d::asset {
namespace {

constexpr int64_t kMaxSide = 16384;
constexpr int kMaxRepeats = 16;      ///< tiles of a repeated texture, along each axis
constexpr int64_t kColourBlock = 4;  ///< side of a vertex-coloured face's block, in texels
constexpr int64_t kGutter = 4;       ///< texels around packed pictures that repeat their edge

using Uv = std::array<double, 2>;

/// A picture, and the faces that use it with their uvs in it.
struct Patch {
  at::Tensor image;                    ///< [H,W,3] uint8
  std::vector<size_t> faces;           ///< into AssetSource::faces
  std::vector<std::array<Uv, 3>> uvs;  ///< one triple per face
  int64_t x = 0, y = 0;                ///< corner in the merged texture
};

Uv corner_uv(const AssetSource& source, const SourceFace& face, int k) {
  const int32_t index = face.uvs[k];
  if (index < 0) return {0, 0};
  const auto& uv = source.uvs[static_cast<size_t>(index)];
  return {uv[0], uv[1]};
}

at::Tensor plain_image(const std::array<float, 3>& colour) {
  const at::Tensor rgb = at::tensor({colour[0], colour[1], colour[2]}).clamp(0, 1);
  return (rgb * 255 + 0.5).to(at::kByte).expand({4, 4, 3}).contiguous();
}

/// Moves the uvs of one axis into [0, tiles] and returns the number of tiles that they span.
int wrap_axis(Patch& patch, int axis, Wrap wrap, const std::string& where) {
  constexpr double kSlack = 1e-4;  // rounding in exporters must not add a second tile
  double most = 1;
  bool outside = false;
  for (auto& corners : patch.uvs) {
    double low = corners[0][axis], high = low;
    for (const Uv& uv : corners) {
      low = std::min(low, uv[axis]);
      high = std::max(high, uv[axis]);
    }
    outside = outside || low < -kSlack || high > 1 + kSlack;
    const bool shift = wrap == Wrap::kRepeat && (low < -kSlack || high > 1 + kSlack);
    const double offset = shift ? std::floor(low + kSlack) : 0;
    for (Uv& uv : corners) {
      uv[axis] = std::max(0.0, uv[axis] - offset);
      if (wrap != Wrap::kRepeat) uv[axis] = std::min(1.0, uv[axis]);
      most = std::max(most, uv[axis]);
    }
  }
  if (outside && wrap == Wrap::kMirror) {
    throw InputError(where +
                     "its texture repeats in mirrored form, which is not supported; bake the asset "
                     "to uvs within [0,1]");
  }
  const double tiles = std::ceil(most - kSlack);
  if (tiles > kMaxRepeats) {
    throw InputError(where + "its texture repeats more than " + std::to_string(kMaxRepeats) +
                     " times over one face; bake the asset to uvs within [0,1]");
  }
  return std::max(1, static_cast<int>(tiles));
}

/// Repeats the picture as often as the uvs need, and scales them to [0,1].
void tile_patch(Patch& patch, const SourceMaterial& material, const AssetSource& source) {
  const std::string where = source.path.string() + ": material '" + material.name + "': ";
  const int across = wrap_axis(patch, 0, material.wrap_u, where);
  const int down = wrap_axis(patch, 1, material.wrap_v, where);
  if (patch.image.size(1) * across > kMaxSide || patch.image.size(0) * down > kMaxSide) {
    throw InputError(where + "its texture, repeated for its uvs, is larger than " +
                     std::to_string(kMaxSide) + " texels; bake the asset to uvs within [0,1]");
  }
  if (across > 1 || down > 1) patch.image = patch.image.repeat({down, across, 1});
  for (auto& corners : patch.uvs) {
    for (Uv& uv : corners) uv = {std::min(1.0, uv[0] / across), std::min(1.0, uv[1] / down)};
  }
}

bool has_colours(const AssetSource& source, const SourceFace& face) {
  if (source.colours.empty()) return false;
  return std::all_of(face.vertices.begin(), face.vertices.end(),
                     [&](int32_t v) { return source.colours[static_cast<size_t>(v)][0] >= 0; });
}

/// Draws one vertex-coloured face into its block. The corners lie on texel centres, and the texels
/// beyond the diagonal continue the gradient, so that bilinear look-ups return exactly the
/// interpolated colours.
void draw_block(const AssetSource& source, const SourceFace& face, uint8_t* out, int64_t pitch) {
  constexpr auto kSteps = static_cast<float>(kColourBlock - 1);
  const auto colour = [&](int k) { return source.colours[static_cast<size_t>(face.vertices[k])]; };
  for (int64_t row = 0; row < kColourBlock; ++row) {
    for (int64_t column = 0; column < kColourBlock; ++column) {
      const float b = static_cast<float>(column) / kSteps;
      const float c = static_cast<float>(row) / kSteps;
      for (int a = 0; a < 3; ++a) {
        const float value = (1 - b - c) * colour(0)[a] + b * colour(1)[a] + c * colour(2)[a];
        out[row * pitch + 3 * column + a] =
            static_cast<uint8_t>(std::lround(std::clamp(value, 0.F, 1.F) * 255.F));
      }
    }
  }
}

/// A picture with a block for each vertex-coloured face.
Patch colour_patch(const AssetSource& source, const std::vector<size_t>& faces) {
  Patch patch;
  patch.faces = faces;
  const auto count = static_cast<int64_t>(faces.size());
  const auto columns = static_cast<int64_t>(std::ceil(std::sqrt(static_cast<double>(count))));
  const int64_t rows = (count + columns - 1) / columns;
  const int64_t width = columns * kColourBlock, height = rows * kColourBlock;
  if (width > kMaxSide) {
    throw InputError(source.path,
                     "has too many vertex-coloured faces; bake the colours to a "
                     "texture");
  }
  patch.image = at::zeros({height, width, 3}, at::kByte);
  uint8_t* pixels = patch.image.data_ptr<uint8_t>();
  for (int64_t i = 0; i < count; ++i) {
    const int64_t x = i % columns * kColourBlock, y = i / columns * kColourBlock;
    draw_block(source, source.faces[faces[static_cast<size_t>(i)]], pixels + 3 * (y * width + x),
               3 * width);
    const auto at = [&](int64_t dx, int64_t dy) {
      return Uv{(static_cast<double>(x + dx) + 0.5) / static_cast<double>(width),
                (static_cast<double>(y + dy) + 0.5) / static_cast<double>(height)};
    };
    patch.uvs.push_back({at(0, 0), at(kColourBlock - 1, 0), at(0, kColourBlock - 1)});
  }
  return patch;
}

/// One patch per material in use, and one for all vertex-coloured faces.
std::vector<Patch> make_patches(const AssetSource& source) {
  std::vector<Patch> by_material(source.materials.size());
  std::vector<size_t> coloured;
  for (size_t i = 0; i < source.faces.size(); ++i) {
    const SourceFace& face = source.faces[i];
    const auto material = static_cast<size_t>(face.material);
    if (!source.materials[material].image.defined() && has_colours(source, face)) {
      coloured.push_back(i);
      continue;
    }
    Patch& patch = by_material[material];
    patch.faces.push_back(i);
    patch.uvs.push_back(
        {corner_uv(source, face, 0), corner_uv(source, face, 1), corner_uv(source, face, 2)});
  }
  std::vector<Patch> patches;
  for (size_t m = 0; m < by_material.size(); ++m) {
    if (by_material[m].faces.empty()) continue;
    const SourceMaterial& material = source.materials[m];
    Patch& patch = patches.emplace_back(std::move(by_material[m]));
    patch.image = material.image.defined() ? material.image : plain_image(material.colour);
    if (!material.image.defined()) {
      for (auto& corners : patch.uvs) corners.fill({0.5, 0.5});
    }
    tile_patch(patch, material, source);
  }
  if (!coloured.empty()) patches.push_back(colour_patch(source, coloured));
  return patches;
}

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

template <typename T, size_t N, typename Source>
at::Tensor to_tensor(const std::vector<std::array<Source, N>>& values, at::ScalarType type) {
  at::Tensor tensor = at::empty({std::ssize(values), static_cast<int64_t>(N)}, type);
  T* out = tensor.data_ptr<T>();
  for (const auto& value : values) {
    for (const Source v : value) *out++ = static_cast<T>(v);
  }
  return tensor;
}

/// True if one texture serves all faces and all uvs lie inside it, so that nothing needs to be
/// merged.
bool is_simple(const AssetSource& source) {
  const bool inside = std::all_of(source.uvs.begin(), source.uvs.end(), [](const auto& uv) {
    return uv[0] >= 0 && uv[0] <= 1 && uv[1] >= 0 && uv[1] <= 1;
  });
  return inside && std::all_of(source.faces.begin(), source.faces.end(), [&](const auto& face) {
           return face.material == source.faces[0].material && face.uvs[0] >= 0 &&
                  face.uvs[1] >= 0 && face.uvs[2] >= 0 &&
                  source.materials[static_cast<size_t>(face.material)].image.defined();
         });
}

void merge_patches(const AssetSource& source, TexturedMesh& mesh) {
  std::vector<Patch> patches = make_patches(source);
  const auto [height, width] = place_patches(patches);
  if (height > kMaxSide || width > kMaxSide) {
    throw InputError(source.path, "its textures together are larger than " +
                                      std::to_string(kMaxSide) + " texels; shrink them");
  }
  mesh.texture = at::zeros({height, width, 3}, at::kByte);
  std::vector<std::array<double, 2>> uvs(3 * source.faces.size());
  for (const Patch& patch : patches) {
    paste(patch, mesh.texture);
    const auto patch_width = static_cast<double>(patch.image.size(1));
    const auto patch_height = static_cast<double>(patch.image.size(0));
    for (size_t i = 0; i < patch.faces.size(); ++i) {
      for (size_t k = 0; k < 3; ++k) {
        const Uv& uv = patch.uvs[i][k];
        uvs[3 * patch.faces[i] + k] = {
            (static_cast<double>(patch.x) + uv[0] * patch_width) / static_cast<double>(width),
            (static_cast<double>(patch.y) + uv[1] * patch_height) / static_cast<double>(height)};
      }
    }
  }
  mesh.map.uvs = to_tensor<float>(uvs, at::kFloat);
  mesh.map.faces = at::arange(std::ssize(uvs), at::kInt).view({-1, 3});
}

}  // namespace

TexturedMesh merge_materials(const AssetSource& source) {
  if (source.faces.empty()) throw InputError(source.path, "contains no triangles");
  TexturedMesh mesh;
  mesh.vertices = to_tensor<float>(source.positions, at::kFloat);
  std::vector<std::array<int32_t, 3>> faces, uv_faces;
  for (const SourceFace& face : source.faces) {
    faces.push_back(face.vertices);
    uv_faces.push_back(face.uvs);
  }
  mesh.faces = to_tensor<int32_t>(faces, at::kInt);
  if (!is_simple(source)) {
    merge_patches(source, mesh);
    return mesh;
  }
  mesh.map.uvs = to_tensor<float>(source.uvs, at::kFloat);
  mesh.map.faces = to_tensor<int32_t>(uv_faces, at::kInt);
  mesh.texture = source.materials[static_cast<size_t>(source.faces[0].material)].image;
  return mesh;
}

}  // namespace tt3d::asset
