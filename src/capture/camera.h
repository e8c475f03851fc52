#pragma once

#include <string>

#include "linear.h"
#include "tt3d/capture.h"

namespace tt3d {

/// Refuses poses that are not finite, singular, mirrored or not rigid (InputError starting with
/// `where`); removes rounding errors from the rotation.
void check_pose(linear::Mat4& pose, const std::string& where);

/// Refuses sizes and intrinsics that are not positive and finite.
void check_intrinsics(const Camera& camera, const std::string& where);

}  // namespace tt3d
