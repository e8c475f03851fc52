#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>

#include "tt3d/linear.h"
#include "tt3d/scene.h"

namespace tt3d::scene {

using namespace linear;
using at::Tensor;

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
  return product(projection, view);
}

Tensor clip_matrices(const std::vector<Camera>& cameras, double extent) {
  Tensor matrices = at::empty({static_cast<int64_t>(cameras.size()), 4, 4});
  auto* out = matrices.mutable_data_ptr<float>();
  for (const Camera& camera : cameras) {
    const auto p = camera.position();
    const double distance = std::hypot(p[0], p[1], p[2]);
    const double near = std::max(0.01, distance - extent), far = distance + extent;
    for (const double x : world_to_clip(camera, near, far)) *out++ = static_cast<float>(x);
  }
  return matrices;
}

// ---- Boxes --------------------------------------------------------------------------------

namespace {

constexpr int64_t kSmallestBox = 11;  ///< side of SSIM's window

/// Widens [low, high) to at least the smallest box and moves it into [0, size).
void widen(int64_t& low, int64_t& high, int64_t size) {
  low = std::clamp<int64_t>(low, 0, size);
  high = std::clamp<int64_t>(high, 0, size);
  const int64_t missing = std::min(kSmallestBox, size) - (high - low);
  if (missing > 0) {
    low = std::clamp<int64_t>(low - (missing + 1) / 2, 0, size - std::min(kSmallestBox, size));
    high = low + std::min(kSmallestBox, size);
  }
}

}  // namespace

PixelBox object_box(const Camera& camera, const Tensor& vertices) {
  const Tensor matrix =
      at::tensor(at::ArrayRef<double>(camera.camera_to_world.data(), 16), at::kDouble).view({4, 4});
  const Tensor seen = (vertices.to(at::kCPU, at::kDouble) - matrix.slice(0, 0, 3).select(1, 3))
                          .matmul(matrix.slice(0, 0, 3).slice(1, 0, 3));
  const Tensor depth = -seen.select(1, 2);
  if (depth.min().item<double>() <= 0) return {0, 0, camera.width, camera.height};
  const Tensor x = camera.cx + camera.fx * seen.select(1, 0) / depth;
  const Tensor y = camera.cy - camera.fy * seen.select(1, 1) / depth;
  const auto low = [](const Tensor& t) {
    return static_cast<int64_t>(std::floor(t.min().item<double>()));
  };
  const auto high = [](const Tensor& t) {
    return static_cast<int64_t>(std::ceil(t.max().item<double>()));
  };
  PixelBox box{low(x), low(y), high(x), high(y)};
  widen(box.left, box.right, camera.width);
  widen(box.top, box.bottom, camera.height);
  return box;
}

}  // namespace tt3d::scene
