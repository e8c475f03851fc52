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

}  // namespace

Tensor Normalization::to_inside(const Tensor& points) const {
  return ((points.to(at::kDouble) - tensor_of(centre, points)) * scale).to(at::kFloat);
}

Tensor Normalization::to_world(const Tensor& points) const {
  return (points.to(at::kDouble) / scale + tensor_of(centre, points)).to(at::kFloat).contiguous();
}

Camera Normalization::to_world(Camera camera) const {
  for (int k = 0; k < 3; ++k) {
    double& x = camera.camera_to_world[4 * k + 3];
    x = x / scale + centre[k];
  }
  return camera;
}

ViewFrame Normalization::to_world(ViewFrame frame) const {
  for (int k = 0; k < 3; ++k) frame.centre[k] = frame.centre[k] / scale + centre[k];
  frame.radius /= scale;
  frame.distance /= scale;
  return frame;
}

Camera Normalization::to_inside(Camera camera) const {
  set_column(camera.camera_to_world, 3, scale * (camera.position() - centre));
  return camera;
}

}  // namespace tt3d::scene
