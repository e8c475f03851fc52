#include <ATen/ATen.h>

#include "tt3d/linear.h"
#include "tt3d/scene.h"

namespace tt3d::scene {

using namespace linear;
using at::Tensor;

namespace {

/// A float64 tensor [3] on the device of `like`.
Tensor tensor_of(const Vec3& v, const Tensor& like) {
  return at::tensor({v[0], v[1], v[2]}, like.options().dtype(at::kDouble));
}

bool is_upright(const Vec3& up) { return up[2] == 1; }

/// The rotation as a float64 tensor [3,3] on the device of `like`, transposed for row vectors.
Tensor row_rotation(const Vec3& up, const Tensor& like) {
  const Mat4 m = rotation_to_z(up);
  const Tensor out = at::empty({3, 3}, at::kDouble);
  for (int64_t r = 0; r < 3; ++r) {
    for (int64_t c = 0; c < 3; ++c) out[r][c] = m[static_cast<size_t>(4 * c + r)];
  }
  return out.to(like.device());
}

/// Rotates the axes of a camera, not its position.
void rotate_axes(const Mat4& rotation, Mat4& pose) {
  for (int c = 0; c < 3; ++c) set_column(pose, c, rotated(rotation, column(pose, c)));
}

}  // namespace

Tensor Normalization::to_inside(const Tensor& points) const {
  const Tensor scaled = (points.to(at::kDouble) - tensor_of(centre, points)) * scale;
  if (is_upright(up)) return scaled.to(at::kFloat);
  return scaled.matmul(row_rotation(up, points)).to(at::kFloat);
}

Tensor Normalization::to_world(const Tensor& points) const {
  Tensor scaled = points.to(at::kDouble) / scale;
  if (!is_upright(up)) scaled = scaled.matmul(row_rotation(up, points).t());
  return (scaled + tensor_of(centre, points)).to(at::kFloat).contiguous();
}

Camera Normalization::to_world(Camera camera) const {
  if (!is_upright(up)) {
    const Mat4 back = transposed(rotation_to_z(up));
    rotate_axes(back, camera.camera_to_world);
    set_column(camera.camera_to_world, 3, rotated(back, camera.position()));
  }
  for (int k = 0; k < 3; ++k) {
    double& x = camera.camera_to_world[4 * k + 3];
    x = x / scale + centre[k];
  }
  return camera;
}

ViewFrame Normalization::to_world(ViewFrame frame) const {
  if (!is_upright(up)) {
    const Mat4 back = transposed(rotation_to_z(up));
    frame.centre = rotated(back, frame.centre);
    frame.up = rotated(back, frame.up);
  }
  for (int k = 0; k < 3; ++k) frame.centre[k] = frame.centre[k] / scale + centre[k];
  frame.radius /= scale;
  frame.distance /= scale;
  return frame;
}

Camera Normalization::to_inside(Camera camera) const {
  set_column(camera.camera_to_world, 3, scale * (camera.position() - centre));
  if (!is_upright(up)) {
    const Mat4 rotation = rotation_to_z(up);
    rotate_axes(rotation, camera.camera_to_world);
    set_column(camera.camera_to_world, 3, rotated(rotation, camera.position()));
  }
  return camera;
}

}  // namespace tt3d::scene
