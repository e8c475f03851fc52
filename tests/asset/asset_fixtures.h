#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "tt3d/asset.h"

namespace tt3d::testing {

/// A bumpy sphere with 2 * `rings` * `sectors` faces (degenerate at the poles), of about unit
/// radius around (1, 2, 3), with a uv seam and a texture of distinct texels.
[[nodiscard]] asset::TexturedMesh bumpy_sphere(int rings, int sectors);

/// [3F,3] positions of all faces' corners: independent of how faces share vertices.
[[nodiscard]] at::Tensor corner_positions(const asset::TexturedMesh& mesh);
/// [3F,2] uvs of the corners.
[[nodiscard]] at::Tensor corner_uvs(const asset::TexturedMesh& mesh);
/// [3F,3] float: the texels nearest to the corners' uvs.
[[nodiscard]] at::Tensor corner_colours(const asset::TexturedMesh& mesh);

/// A GLB made by hand from JSON and a binary chunk.
[[nodiscard]] std::string make_glb(const nlohmann::json& root, std::string binary);
/// The two parts of a GLB.
void split_glb(const std::string& bytes, nlohmann::json& root, std::string& binary);

/// The message of the InputError that loading the file throws, "" if it loads.
[[nodiscard]] std::string asset_error(const std::filesystem::path& path);

}  // namespace tt3d::testing
