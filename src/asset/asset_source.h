#pragma once

#include <ATen/core/Tensor.h>

#include <array>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "tt3d/asset.h"

/// The result of the loaders, before materials are merged into one texture.
namespace tt3d::asset {

/// Meaning of uvs outside [0,1].
enum class Wrap { kRepeat, kClamp, kMirror };

struct SourceMaterial {
  std::string name;                      ///< for error messages
  at::Tensor image;                      ///< [H,W,3] uint8 sRGB; undefined: no texture
  std::array<float, 3> colour{1, 1, 1};  ///< sRGB in [0,1], used without an image
  Wrap wrap_u = Wrap::kRepeat, wrap_v = Wrap::kRepeat;
  /// The texture is looked up at uv * scale + offset, with (0,0) at the top left.
  std::array<double, 2> uv_scale{1, 1}, uv_offset{0, 0};
};

struct SourceFace {
  std::array<int32_t, 3> vertices{};
  std::array<int32_t, 3> uvs{-1, -1, -1};      ///< -1: none
  std::array<int32_t, 3> colours{-1, -1, -1};  ///< -1: none
  int32_t material = 0;
};

struct AssetSource {
  std::filesystem::path path;
  std::vector<std::array<double, 3>> positions;  ///< world, +Z up
  std::vector<std::array<float, 3>> colours;     ///< of corners; see linear_colours
  /// True (glTF): colours are linear and multiply the material's colour or texture. False (OBJ):
  /// colours are sRGB and replace the material's colour; a texture hides them.
  bool linear_colours = false;
  /// True (glTF): vertices at the same position become one, so that the surface is closed again;
  /// glTF splits them along uv seams.
  bool weld = false;
  std::vector<std::array<float, 2>> uvs;  ///< (0,0) top-left
  std::vector<SourceFace> faces;
  std::vector<SourceMaterial> materials;
  std::set<std::string> notes;  ///< lines for the user: what the reader ignored or replaced
  std::set<std::filesystem::path> files;  ///< that were read
};

/// Merges all materials into one texture and adapts the uvs. Throws InputError.
[[nodiscard]] TexturedMesh merge_materials(const AssetSource& source);

/// Sets vertices, faces and origin of the mesh. Throws InputError.
void place_vertices(const AssetSource& source, TexturedMesh& mesh);

[[nodiscard]] AssetSource read_obj(const std::filesystem::path& path);
[[nodiscard]] AssetSource read_gltf(const std::filesystem::path& path);

/// Maximum size of a file of an asset, mesh or picture; this bounds the memory.
inline constexpr uintmax_t kMaxPartBytes = uintmax_t{1} << 30;

/// read_file for the files of an asset; adds the path to `files`. InputError for a file over
/// kMaxPartBytes.
[[nodiscard]] std::string read_part(const std::filesystem::path& path,
                                    std::set<std::filesystem::path>& files);

/// The file that an asset refers to, inside the asset's folder. If the reference leads elsewhere or
/// to nothing, a file of the same name beside the asset is taken. Upper and lower case may differ
/// if only one file fits. nullopt if there is no such file.
[[nodiscard]] std::optional<std::filesystem::path> find_reference(
    const std::filesystem::path& asset, const std::string& reference);
/// find_reference; throws InputError if there is no such file.
[[nodiscard]] std::filesystem::path resolve_reference(const std::filesystem::path& asset,
                                                      const std::string& reference);

/// Decoded pictures. Equal files are decoded once and share one tensor.
class Pictures {
 public:
  /// [H,W,3] uint8 of a picture file; alpha is dropped. `name` is the file in errors.
  [[nodiscard]] at::Tensor decode(std::string_view bytes, const std::filesystem::path& name);
  /// `image` multiplied by a factor in linear light.
  [[nodiscard]] at::Tensor tint(const at::Tensor& image, const std::array<double, 3>& factor);

 private:
  std::map<std::string, at::Tensor> decoded_;  ///< by SHA-256
  std::map<std::pair<const void*, std::array<double, 3>>, at::Tensor> tinted_;
};

/// Triangles of a polygon, as indices of its corners: a fan around the first corner if that is
/// right, else by ear clipping in the polygon's dominant plane. A degenerate or self-intersecting
/// polygon becomes a fan. nullopt if the polygon is concave and has over kMaxConcaveCorners
/// corners.
[[nodiscard]] std::optional<std::vector<std::array<size_t, 3>>> triangulate(
    const std::vector<std::array<double, 3>>& corners);
inline constexpr size_t kMaxConcaveCorners = 10000;

}  // namespace tt3d::asset
