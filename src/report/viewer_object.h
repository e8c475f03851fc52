#pragma once

#include <filesystem>
#include <string>

#include "html.h"

namespace tt3d::report {

/// An asset as the page's viewer reads it: `positions` uint16 [V,3] over the box from `low` with
/// sides `size`, `uvs` uint16 [V,2] over [0,1], `indices` uint32 [F,3], each little-endian in
/// base64; `texture` a data: address. Throws InputError.
[[nodiscard]] Json viewer_object(const std::filesystem::path& asset, const std::string& name);

}  // namespace tt3d::report
