#pragma once

#include <ATen/core/Tensor.h>

#include <array>
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
};

struct SourceFace {
  std::array<int32_t, 3> vertices{};
  std::array<int32_t, 3> uvs{-1, -1, -1};  ///< -1: none
  int32_t material = 0;
};

struct AssetSource {
  std::filesystem::path path;
  std::vector<std::array<float, 3>> positions;  ///< world, +Z up
  std::vector<std::array<float, 3>> colours;    ///< sRGB, one per position; negative: none
  std::vector<std::array<float, 2>> uvs;        ///< (0,0) top-left
  std::vector<SourceFace> faces;
  std::vector<SourceMaterial> materials;
};

/// Merges all materials into one texture and adapts the uvs. Throws InputError.
[[nodiscard]] TexturedMesh merge_materials(const AssetSource& source);

[[nodiscard]] AssetSource read_obj(const std::filesystem::path& path);
[[nodiscard]] AssetSource read_glb(const std::filesystem::path& path);

/// Maximum size of a file of an asset, mesh or picture; this bounds the memory.
inline constexpr uintmax_t kMaxPartBytes = uintmax_t{1} << 30;

/// read_file for the files of an asset; InputError for one over kMaxPartBytes.
[[nodiscard]] std::string read_part(const std::filesystem::path& path);

/// A file named by an asset, inside the asset's folder. Throws InputError if the path is absolute
/// or leads out of the folder.
[[nodiscard]] std::filesystem::path resolve_reference(const std::filesystem::path& asset,
                                                      const std::string& reference);

/// [H,W,3] uint8 of a PNG or JPEG; alpha is dropped.
[[nodiscard]] at::Tensor rgb_image(std::string_view bytes, const std::filesystem::path& name);

}  // namespace tt3d::asset
