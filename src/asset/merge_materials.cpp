#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <tuple>

#include "patches.h"

// Several materials become one texture in three steps. First, every material gets a picture, and
// its faces get uvs within it (repeated textures are tiled, plain and vertex colours are drawn).
// Then the pictures are packed on shelves, and the uvs are adapted. A single plain texture is not
// changed.

namespace tt3d::asset {

Uv corner_uv(const AssetSource& source, const SourceFace& face, size_t k) {
  const int32_t index = face.uvs[k];
  if (index < 0) return {0, 0};
  const auto& uv = source.uvs[static_cast<size_t>(index)];
  const SourceMaterial& material = source.materials[static_cast<size_t>(face.material)];
  return {uv[0] * material.uv_scale[0] + material.uv_offset[0],
          uv[1] * material.uv_scale[1] + material.uv_offset[1]};
}

bool shows_colours(const AssetSource& source, const SourceFace& face) {
  const SourceMaterial& material = source.materials[static_cast<size_t>(face.material)];
  return face.colours[0] >= 0 && (source.linear_colours || !material.image.defined());
}

namespace {

constexpr int kMaxRepeats = 16;  ///< tiles of a repeated texture, along each axis
constexpr double kSlack = 1e-4;  ///< rounding in exporters must not add a second tile

at::Tensor plain_image(const std::array<float, 3>& colour) {
  const at::Tensor rgb = at::tensor({colour[0], colour[1], colour[2]}).clamp(0, 1);
  return (rgb * 255 + 0.5).to(at::kByte).expand({4, 4, 3}).contiguous();
}

/// Moves the uvs of one axis into [0, tiles] and returns the number of tiles that they span.
int wrap_axis(Patch& patch, int axis, Wrap wrap, const std::string& where) {
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

/// Names a picture and the way it continues outside [0,1] along each axis.
using PictureKey = std::tuple<const void*, Wrap, Wrap>;

/// The wrap of a picture along one axis; kClamp if no uv lies outside, so that it does not matter.
Wrap needed_wrap(const std::vector<std::array<Uv, 3>>& uvs, size_t axis, Wrap wrap) {
  const bool inside = std::all_of(uvs.begin(), uvs.end(), [&](const std::array<Uv, 3>& corners) {
    return std::all_of(corners.begin(), corners.end(),
                       [&](const Uv& uv) { return uv[axis] >= -kSlack && uv[axis] <= 1 + kSlack; });
  });
  return inside ? Wrap::kClamp : wrap;
}

/// One patch per picture and per plain colour in use. `by_material`: the faces of each material.
std::vector<Patch> material_patches(const AssetSource& source, std::vector<Patch> by_material) {
  std::vector<Patch> patches;
  std::vector<SourceMaterial> used;
  std::map<PictureKey, size_t> known;
  for (size_t m = 0; m < by_material.size(); ++m) {
    Patch& patch = by_material[m];
    if (patch.faces.empty()) continue;
    SourceMaterial material = source.materials[m];
    if (material.image.defined()) {
      material.wrap_u = needed_wrap(patch.uvs, 0, material.wrap_u);
      material.wrap_v = needed_wrap(patch.uvs, 1, material.wrap_v);
      const PictureKey key = {material.image.const_data_ptr(), material.wrap_u, material.wrap_v};
      const auto [entry, fresh] = known.try_emplace(key, patches.size());
      if (!fresh) {
        Patch& same = patches[entry->second];
        same.faces.insert(same.faces.end(), patch.faces.begin(), patch.faces.end());
        same.uvs.insert(same.uvs.end(), patch.uvs.begin(), patch.uvs.end());
        continue;
      }
      patch.image = material.image;
    } else {
      patch.image = plain_image(material.colour);
      for (auto& corners : patch.uvs) corners.fill({0.5, 0.5});
    }
    patches.push_back(std::move(patch));
    used.push_back(std::move(material));
  }
  for (size_t i = 0; i < patches.size(); ++i) tile_patch(patches[i], used[i], source);
  return patches;
}

/// The patches of all faces.
std::vector<Patch> make_patches(const AssetSource& source) {
  std::vector<Patch> by_material(source.materials.size());
  std::vector<size_t> coloured;
  for (size_t i = 0; i < source.faces.size(); ++i) {
    const SourceFace& face = source.faces[i];
    if (shows_colours(source, face)) {
      coloured.push_back(i);
      continue;
    }
    Patch& patch = by_material[static_cast<size_t>(face.material)];
    patch.faces.push_back(i);
    patch.uvs.push_back(
        {corner_uv(source, face, 0), corner_uv(source, face, 1), corner_uv(source, face, 2)});
  }
  std::vector<Patch> patches = material_patches(source, std::move(by_material));
  if (coloured.empty()) return patches;
  for (Patch& patch : draw_colours(source, coloured)) patches.push_back(std::move(patch));
  return patches;
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
  const auto material_of = [&](const SourceFace& face) -> const SourceMaterial& {
    return source.materials[static_cast<size_t>(face.material)];
  };
  const at::Tensor& first = material_of(source.faces[0]).image;
  return inside && std::all_of(source.faces.begin(), source.faces.end(), [&](const auto& face) {
           const SourceMaterial& material = material_of(face);
           return material.image.defined() && material.image.is_same(first) &&
                  material.uv_scale == std::array{1.0, 1.0} &&
                  material.uv_offset == std::array{0.0, 0.0} && !shows_colours(source, face) &&
                  face.uvs[0] >= 0 && face.uvs[1] >= 0 && face.uvs[2] >= 0;
         });
}

void merge_patches(const AssetSource& source, TexturedMesh& mesh) {
  std::vector<Patch> patches = make_patches(source);
  mesh.texture = pack_patches(patches, source.path);
  const int64_t height = mesh.texture.size(0), width = mesh.texture.size(1);
  std::vector<std::array<double, 2>> uvs(3 * source.faces.size());
  for (const Patch& patch : patches) {
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
  place_vertices(source, mesh);
  if (!is_simple(source)) {
    merge_patches(source, mesh);
    return mesh;
  }
  mesh.map.uvs = to_tensor<float>(source.uvs, at::kFloat);
  std::vector<std::array<int32_t, 3>> uv_faces;
  uv_faces.reserve(source.faces.size());
  for (const SourceFace& face : source.faces) uv_faces.push_back(face.uvs);
  mesh.map.faces = to_tensor<int32_t>(uv_faces, at::kInt);
  mesh.texture = source.materials[static_cast<size_t>(source.faces[0].material)].image;
  return mesh;
}

}  // namespace tt3d::asset
