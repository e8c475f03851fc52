#include "camera.h"

#include <algorithm>
#include <numbers>

#include "tt3d/capture.h"
#include "tt3d/linear.h"
#include "tt3d/scene.h"

namespace tt3d::capture {

using namespace scene::linear;

void check_pose(Mat4& pose, const std::string& where) {
  for (const double value : pose) {
    if (!std::isfinite(value)) throw InputError(where + ": contains a value that is not finite");
  }
  constexpr double kTolerance = 5e-3;
  const Vec3 x = column(pose, 0);
  const Vec3 y = column(pose, 1);
  const Vec3 z = column(pose, 2);
  const double determinant = dot(cross(x, y), z);
  if (std::abs(determinant) < 1e-9) throw InputError(where + ": the matrix is singular");
  if (determinant < 0) {
    throw InputError(where +
                     ": the matrix mirrors (determinant below 0); expected a rotation, "
                     "with x right, y up and z backwards");
  }
  const double error =
      std::max({std::abs(dot(x, x) - 1), std::abs(dot(y, y) - 1), std::abs(dot(z, z) - 1),
                std::abs(dot(x, y)), std::abs(dot(y, z)), std::abs(dot(x, z))});
  const double last = std::max(
      {std::abs(pose[12]), std::abs(pose[13]), std::abs(pose[14]), std::abs(pose[15] - 1)});
  if (error > kTolerance || last > kTolerance) {
    throw InputError(where + ": is not a rotation and a translation; remove scale and shear");
  }
  // Gram-Schmidt removes the rounding errors of the file.
  const Vec3 zn = normalized(z);
  const Vec3 xn = normalized(x - dot(x, zn) * zn);
  pose = frame(xn, cross(zn, xn), zn, column(pose, 3));
}

void check_intrinsics(const scene::Camera& camera, const std::string& where) {
  const auto positive = [](double value) { return std::isfinite(value) && value > 0; };
  if (camera.width <= 0 || camera.height <= 0) {
    throw InputError(where + ": the image size must be positive");
  }
  if (!positive(camera.fx) || !positive(camera.fy)) {
    throw InputError(where + ": the focal length must be a positive number");
  }
  if (!std::isfinite(camera.cx) || !std::isfinite(camera.cy)) {
    throw InputError(where + ": the principal point must be finite");
  }
}

scene::ViewFrame capture_view_frame(const Capture& capture) {
  std::vector<double> distances;
  std::vector<double> angles;
  for (const View& view : capture.train) {
    distances.push_back(length(view.camera.position()));
    angles.push_back(2 * std::atan(0.5 * view.camera.height / view.camera.fy));
  }
  if (distances.empty()) throw InputError("the capture has no training views");
  const auto median = [](std::vector<double>& values) {
    const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
    std::nth_element(values.begin(), middle, values.end());
    return *middle;
  };
  scene::ViewFrame view_frame;
  view_frame.radius = capture.object_radius;
  view_frame.distance = median(distances);
  view_frame.fov_y_deg = median(angles) * 180 / std::numbers::pi;
  return view_frame;
}

}  // namespace tt3d::capture
