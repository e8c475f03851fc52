#include <algorithm>
#include <cmath>
#include <numbers>

#include "tt3d/linear.h"
#include "tt3d/scene.h"

namespace tt3d::scene {

using namespace linear;

namespace {

constexpr double kDegree = std::numbers::pi / 180;
/// Look-at jitter of `dome` as a fraction of the object's radius.
constexpr double kLookAtJitter = 0.05;
/// In-plane shift of `paper`, for an object in the unit sphere.
constexpr double kPaperShift = 0.1;

/// Camera on a sphere around `target`. The axes are computed from the angles instead of a cross
/// product with the up vector, so the poles need no special case.
Mat4 orbit_pose(const Vec3& target, const SampledView& view) {
  const double azimuth = view.azimuth_deg * kDegree;
  const double elevation = view.elevation_deg * kDegree;
  const double roll = view.roll_deg * kDegree;
  const Vec3 right = {-std::sin(azimuth), std::cos(azimuth), 0};
  const Vec3 back = {std::cos(elevation) * std::cos(azimuth),
                     std::cos(elevation) * std::sin(azimuth), std::sin(elevation)};
  const Vec3 up = cross(back, right);
  const Vec3 x = std::cos(roll) * right + std::sin(roll) * up;
  const Vec3 y = std::cos(roll) * up - std::sin(roll) * right;
  return frame(x, y, back, target + view.distance * back);
}

Camera square_camera(const Mat4& pose, int size, const ViewFrame& view_frame) {
  Camera camera;
  camera.camera_to_world = pose;
  camera.width = camera.height = size;
  camera.cx = camera.cy = 0.5 * size;
  camera.fx = camera.fy = 0.5 * size / std::tan(0.5 * view_frame.fov_y_deg * kDegree);
  return camera;
}

Mat4 sample_ring(Random& random, const ViewFrame& view_frame, SampledView& view) {
  view.azimuth_deg = random.uniform(0, 360);
  view.elevation_deg = 15;
  view.distance = view_frame.distance;
  return orbit_pose(view_frame.centre, view);
}

Mat4 sample_dome(Random& random, const ViewFrame& view_frame, SampledView& view) {
  view.azimuth_deg = random.uniform(0, 360);
  view.elevation_deg = random.uniform(-20, 75);
  view.distance = random.uniform(0.95, 1.25) * view_frame.distance;
  view.roll_deg = random.uniform(-10, 10);
  Vec3 target = view_frame.centre;
  for (double& t : target) t += kLookAtJitter * view_frame.radius * random.uniform(-1, 1);
  return orbit_pose(target, view);
}

Mat4 sample_sphere(Random& random, const ViewFrame& view_frame, SampledView& view) {
  view.azimuth_deg = random.uniform(0, 360);
  view.elevation_deg = std::asin(random.uniform(-1, 1)) / kDegree;
  view.distance = view_frame.distance;
  return orbit_pose(view_frame.centre, view);
}

/// v rotated about a coordinate axis.
Vec3 rotate(const Vec3& v, int axis, double angle) {
  const int i = (axis + 1) % 3;
  const int j = (axis + 2) % 3;
  Vec3 out = v;
  out[i] = std::cos(angle) * v[i] - std::sin(angle) * v[j];
  out[j] = std::sin(angle) * v[i] + std::cos(angle) * v[j];
  return out;
}

/// Azimuth, elevation and roll of a camera that orbits the origin with these axes.
void describe_orbit(const Vec3& x, const Vec3& back, SampledView& view) {
  const double azimuth = std::atan2(back[1], back[0]);
  view.azimuth_deg = azimuth / kDegree + (azimuth < 0 ? 360 : 0);
  view.elevation_deg = std::asin(std::clamp(back[2], -1.0, 1.0)) / kDegree;
  const Vec3 right = {-std::sin(azimuth), std::cos(azimuth), 0};
  view.roll_deg = std::atan2(dot(x, cross(back, right)), dot(x, right)) / kDegree;
}

/// The official code uses a Y-up frame with axes (x, y, z) = our (y, z, x). It turns a camera on
/// its +z axis about the x, y and z axes in this order, then shifts it in its plane.
Mat4 sample_paper(Random& random, const ViewFrame& view_frame, SampledView& view) {
  Vec3 x = {0, 1, 0};
  Vec3 back = {1, 0, 0};
  for (const int axis : {1, 2, 0}) {
    const double angle = random.uniform(-60, 120) * kDegree;
    x = rotate(x, axis, angle);
    back = rotate(back, axis, angle);
  }
  const Vec3 y = cross(back, x);
  const double shift_x = kPaperShift * view_frame.radius * random.uniform(-1, 1);
  const double shift_y = kPaperShift * view_frame.radius * random.uniform(-1, 1);
  const Vec3 target = view_frame.centre + shift_x * x + shift_y * y;
  view.distance = view_frame.distance;
  describe_orbit(x, back, view);
  return frame(x, y, back, target + view.distance * back);
}

/// Turns a pose around the centre of the frame so that the frame's up direction takes the place of
/// +Z.
Mat4 turned_up(const Mat4& pose, const ViewFrame& view_frame) {
  if (view_frame.up[2] == 1) return pose;
  const Mat4 back = transposed(rotation_to_z(view_frame.up));
  const Vec3 offset = column(pose, 3) - view_frame.centre;
  return frame(rotated(back, column(pose, 0)), rotated(back, column(pose, 1)),
               rotated(back, column(pose, 2)), view_frame.centre + rotated(back, offset));
}

using Sampler = Mat4 (*)(Random&, const ViewFrame&, SampledView&);

Sampler sampler_of(ViewDistribution distribution) {
  constexpr Sampler kSamplers[] = {sample_ring, sample_dome, sample_sphere, sample_paper};
  return kSamplers[static_cast<size_t>(distribution)];
}

}  // namespace

std::vector<SampledView> sample_views(ViewDistribution distribution, uint64_t seed, int64_t first,
                                      int64_t count, int size, const ViewFrame& view_frame) {
  const Sampler sampler = sampler_of(distribution);
  std::vector<SampledView> views(static_cast<size_t>(std::max<int64_t>(count, 0)));
  for (size_t i = 0; i < views.size(); ++i) {
    Random random(seed, "views/" + name_of(distribution), static_cast<uint64_t>(first) + i);
    const Mat4 pose = turned_up(sampler(random, view_frame, views[i]), view_frame);
    views[i].camera = square_camera(pose, size, view_frame);
  }
  return views;
}

SampledView orbit_view(const ViewFrame& frame, double azimuth_deg, double elevation_deg, int size) {
  SampledView view;
  view.azimuth_deg = azimuth_deg;
  view.elevation_deg = elevation_deg;
  view.distance = frame.distance;
  view.camera = square_camera(turned_up(orbit_pose(frame.centre, view), frame), size, frame);
  return view;
}

std::vector<Camera> cameras_of(const std::vector<SampledView>& views) {
  std::vector<Camera> cameras;
  for (const SampledView& view : views) cameras.push_back(view.camera);
  return cameras;
}

}  // namespace tt3d::scene
