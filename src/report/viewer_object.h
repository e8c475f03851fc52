#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "tt3d/asset.h"

namespace tt3d::report {

/// An asset in the format of the viewer of the page: `positions` uint16 [V,3] over the box with
/// corner `low` and sides `size`, `uvs` uint16 [V,2] over [0,1], `indices` uint32 [F,3], each
/// little-endian in base64; `texture`: a data: address.
[[nodiscard]] nlohmann::json viewer_object(const asset::TexturedMesh& mesh,
                                           const std::string& name);

}  // namespace tt3d::report
