#pragma once

#include <string>

#include "tt3d/capture.h"
#include "tt3d/linear.h"
#include "tt3d/scene.h"

namespace tt3d::capture {

/// Throws InputError (its message starts with `where`) for a pose that is not finite, singular,
/// mirrored or not rigid. Removes rounding errors from the rotation.
void check_pose(scene::linear::Mat4& pose, const std::string& where);

/// Throws InputError for sizes and intrinsics that are not positive and finite.
void check_intrinsics(const scene::Camera& camera, const std::string& where);

}  // namespace tt3d::capture
