#pragma once

#include "raw_view.h"
#include "tt3d/capture.h"
#include "tt3d/linear.h"

namespace tt3d::capture {

/// Finds the similarity transform that maps the object of `capture` (views still in the input's
/// world) into [-1,1]^3, applies it to the cameras and stores it. With masks the object is the
/// visual hull of the training views. Without masks it is where all cameras look, narrowed by the
/// sparse points. Throws InputError that names `path` if no camera sees an object.
void normalize_capture(Capture& capture, const std::vector<scene::linear::Vec3>& points,
                       const std::filesystem::path& path);

}  // namespace tt3d::capture
