#pragma once

namespace tt3d {

/// Version of the library and program, semantic versioning.
inline constexpr const char* kVersion = "0.1.0";

}  // namespace tt3d
