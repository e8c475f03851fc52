#pragma once

#include <vector>

#include "raw_view.h"
#include "tt3d/capture.h"
#include "tt3d/linear.h"

namespace tt3d::capture {

/// The unit up direction of a world from its cameras. A camera without roll has a horizontal x
/// axis, whatever its elevation, so up is most nearly perpendicular to all x axes. If the cameras
/// look in one direction only, it is the mean of their up axes.
[[nodiscard]] scene::linear::Vec3 up_of_cameras(const std::vector<scene::Camera>& cameras);

/// The up direction that `option` asks for. Notes to `progress` if the world is turned.
[[nodiscard]] scene::linear::Vec3 up_of_capture(UpDirection option, CaptureFormat format,
                                                const RawCapture& raw, Progress& progress);

}  // namespace tt3d::capture
