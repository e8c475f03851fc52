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

/// [64,64,3]: red (220,30,30) at the top left, green (30,200,30) at the top right, blue (30,30,220)
/// at the bottom left and yellow (230,220,40) at the bottom right.
[[nodiscard]] at::Tensor four_colours();
/// The nearest texel at a point of the surface; fails the test if no face holds the point.
[[nodiscard]] std::array<int, 3> colour_at(const asset::TexturedMesh& mesh,
                                           const std::array<double, 3>& point);
/// Expects a colour within `tolerance` of each channel.
void expect_colour(const asset::TexturedMesh& mesh, const std::array<double, 3>& point,
                   const std::array<int, 3>& colour, int tolerance = 2);
/// Expects four_colours on the unit square of the x-z plane, red at x = 0, z = 1.
void expect_four_colours(const asset::TexturedMesh& mesh);
/// The sum of the faces' areas.
[[nodiscard]] double surface_area(const asset::TexturedMesh& mesh);

/// load_asset with the notes it gives, one a line.
[[nodiscard]] asset::TexturedMesh load_with_notes(const std::filesystem::path& path,
                                                  std::string& notes);

/// A GLB made by hand from JSON and a binary chunk.
[[nodiscard]] std::string make_glb(const nlohmann::json& root, std::string binary);
/// The two parts of a GLB.
void split_glb(const std::string& bytes, nlohmann::json& root, std::string& binary);

/// The message of the InputError that loading the file throws, "" if it loads.
[[nodiscard]] std::string asset_error(const std::filesystem::path& path);

}  // namespace tt3d::testing
