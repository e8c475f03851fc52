#include "camera.h"

#include <algorithm>
#include <numbers>

#include "tt3d/capture.h"

namespace tt3d {

using namespace linear;

std::array<double, 16> world_to_clip(const Camera& camera, double near_distance,
                                     double far_distance) {
  const Mat4& pose = camera.camera_to_world;
  Mat4 view{};
  for (int r = 0; r < 3; ++r) {
    const Vec3 axis = column(pose, r);
    for (int c = 0; c < 3; ++c) view[4 * r + c] = axis[c];
    view[4 * r + 3] = -dot(axis, camera.position());
  }
  view[15] = 1;

  // Camera space to clip space; w = -z. Column u = cx + fx x/w gives x_clip = 2u/width - 1.
  const double depth = far_distance - near_distance;
  const Mat4 projection = {2 * camera.fx / camera.width,
                           0,
                           1 - 2 * camera.cx / camera.width,
                           0,
                           0,
                           2 * camera.fy / camera.height,
                           2 * camera.cy / camera.height - 1,
                           0,
                           0,
                           0,
                           -(far_distance + near_distance) / depth,
                           -2 * far_distance * near_distance / depth,
                           0,
                           0,
                           -1,
                           0};
  Mat4 clip{};
  for (int r = 0; r < 4; ++r) {
    for (int c = 0; c < 4; ++c) {
      for (int k = 0; k < 4; ++k) clip[4 * r + c] += projection[4 * r + k] * view[4 * k + c];
    }
  }
  return clip;
}

void check_pose(Mat4& pose, const std::string& where) {
  for (const double value : pose) {
    if (!std::isfinite(value)) throw InputError(where + ": holds a value that is not finite");
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
  // Gram-Schmidt removes what rounding in the file left.
  const Vec3 zn = normalized(z);
  const Vec3 xn = normalized(x - dot(x, zn) * zn);
  pose = frame(xn, cross(zn, xn), zn, column(pose, 3));
}

void check_intrinsics(const Camera& camera, const std::string& where) {
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

ViewFrame capture_view_frame(const Capture& capture) {
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
  ViewFrame view_frame;
  view_frame.radius = capture.object_radius;
  view_frame.distance = median(distances);
  view_frame.fov_y_deg = median(angles) * 180 / std::numbers::pi;
  return view_frame;
}

}  // namespace tt3d
