#pragma once

#include "asset_source.h"

/// The parts of a merged texture.
namespace tt3d::asset {

inline constexpr int64_t kMaxSide = 16384;  ///< of a merged texture, in texels

using Uv = std::array<double, 2>;

/// A picture, and the faces that use it with their uvs in it.
struct Patch {
  at::Tensor image;                    ///< [H,W,3] uint8
  std::vector<size_t> faces;           ///< into AssetSource::faces
  std::vector<std::array<Uv, 3>> uvs;  ///< one triple per face
  int64_t x = 0, y = 0;                ///< corner in the merged texture
};

/// The place in its material's texture of corner k of a face; (0,0) if it has no uv.
[[nodiscard]] Uv corner_uv(const AssetSource& source, const SourceFace& face, size_t k);

/// True if the face's colour varies and is not hidden by a texture.
[[nodiscard]] bool shows_colours(const AssetSource& source, const SourceFace& face);

/// Pictures with a square block for each of these faces, in which the interpolated vertex colours
/// are drawn, multiplied by the texture or colour of the material if colours are linear.
[[nodiscard]] std::vector<Patch> draw_colours(const AssetSource& source,
                                              const std::vector<size_t>& faces);

/// Packs the patches on shelves and sets their corners. If they are too large together, the parts
/// of the pictures that no face uses are cut off. Returns the merged texture; throws InputError if
/// it is still too large.
[[nodiscard]] at::Tensor pack_patches(std::vector<Patch>& patches,
                                      const std::filesystem::path& asset);

}  // namespace tt3d::asset
