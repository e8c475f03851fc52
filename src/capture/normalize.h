#pragma once

#include "raw_view.h"
#include "tt3d/capture.h"

namespace tt3d {

/// Finds the similarity that brings the object of `capture` (views still in the input's world)
/// into [-1,1]^3, applies it to the cameras and stores it. With masks the object is the visual
/// hull of the training views; without, what all cameras look at, narrowed by the sparse points.
/// Throws InputError, naming `path`, if no camera sees an object.
void normalize_capture(Capture& capture, const std::vector<linear::Vec3>& points,
                       const std::filesystem::path& path);

}  // namespace tt3d
