#include "normalize.h"

#include <algorithm>

#include "tt3d/linear.h"
#include "tt3d/scene.h"
#include "visual_hull.h"

namespace tt3d::capture {

using namespace scene::linear;

namespace {

/// Radius of the object's ball after normalisation; the rest of the unit ball is margin.
constexpr double kFill = 0.95;
/// Search around the first guess, in multiples of the largest silhouette's radius.
constexpr double kSearch = 1.5;

struct Ray {
  Vec3 origin, direction;
};

/// The point with the least sum of squared distances to the rays' lines; false if the rays are
/// (nearly) parallel.
bool nearest_point(const std::vector<Ray>& rays, Vec3& point) {
  Mat4 a{};
  Vec3 b{};
  for (const Ray& ray : rays) {
    const Vec3& d = ray.direction;
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c) {
        const double value = (r == c ? 1 : 0) - d[r] * d[c];
        a[4 * r + c] += value;
        b[r] += value * ray.origin[c];
      }
    }
  }
  // Cramer's rule on the columns.
  const Vec3 x = column(a, 0);
  const Vec3 y = column(a, 1);
  const Vec3 z = column(a, 2);
  const double determinant = dot(cross(x, y), z);
  const double mean = (x[0] + y[1] + z[2]) / 3;
  if (!(determinant > 1e-5 * mean * mean * mean)) return false;
  point = {dot(cross(b, y), z) / determinant, dot(cross(x, b), z) / determinant,
           dot(cross(x, y), b) / determinant};
  return true;
}

Vec3 common_point(const std::vector<Ray>& rays, const std::filesystem::path& path) {
  Vec3 point{};
  if (rays.size() < 2 || !nearest_point(rays, point)) {
    throw InputError(path,
                     "the cameras do not determine where the object is: fewer than two views, or "
                     "all in the same direction; expected views from around the object");
  }
  return point;
}

Ball locate_by_masks(const Capture& capture, const std::filesystem::path& path) {
  std::vector<Silhouette> silhouettes;
  for (const View& view : capture.train) {
    Silhouette silhouette(view);
    if (!silhouette.empty()) silhouettes.push_back(std::move(silhouette));
  }
  if (silhouettes.empty()) {
    throw InputError(path, "the object never enters the view: all masks of the " +
                               std::to_string(capture.train.size()) + " training images are empty");
  }
  std::vector<Ray> rays;
  for (const Silhouette& s : silhouettes) rays.push_back({s.position(), s.direction()});
  Ball search{common_point(rays, path), 0};
  for (const Silhouette& s : silhouettes) {
    const double distance = length(search.centre - s.position());
    search.radius = std::max(search.radius, kSearch * s.spread() * distance);
  }
  const Ball ball = carve_hull(silhouettes, search);
  if (ball.radius <= 0) {
    throw InputError(path,
                     "the object never enters the view of all cameras: their masks do not "
                     "intersect in space; check that cameras and masks belong together");
  }
  return ball;
}

double median(std::vector<double> values, double share = 0.5) {
  const auto at =
      values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

/// Without masks the object is assumed to be where all cameras look. Its ball fills the view of the
/// middle camera, or encloses nearly all sparse points within that ball, if there are
/// enough.
Ball locate_by_cameras(const Capture& capture, const std::vector<Vec3>& points,
                       const std::filesystem::path& path) {
  std::vector<Ray> rays;
  for (const View& view : capture.train) {
    rays.push_back({view.camera.position(), -1.0 * column(view.camera.camera_to_world, 2)});
  }
  Ball ball{common_point(rays, path), 0};
  std::vector<double> reaches;
  for (size_t i = 0; i < rays.size(); ++i) {
    const Vec3 offset = ball.centre - rays[i].origin;
    if (dot(offset, rays[i].direction) <= 0) continue;
    const scene::Camera& camera = capture.train[i].camera;
    const double tangent =
        std::min(0.5 * camera.width / camera.fx, 0.5 * camera.height / camera.fy);
    reaches.push_back(length(offset) * std::sin(std::atan(tangent)));
  }
  if (2 * reaches.size() < rays.size()) {
    throw InputError(path,
                     "the object never enters the view: most cameras look away from the "
                     "point where their axes meet; check the camera convention (OpenGL: the "
                     "camera looks along -z)");
  }
  ball.radius = median(reaches);
  std::vector<double> distances;
  for (const Vec3& point : points) {
    const double distance = length(point - ball.centre);
    if (distance < ball.radius) distances.push_back(distance);
  }
  constexpr size_t kEnoughPoints = 50;
  if (distances.size() >= kEnoughPoints) ball.radius = 1.05 * median(distances, 0.98);
  return ball;
}

}  // namespace

void normalize_capture(Capture& capture, const std::vector<Vec3>& points,
                       const std::filesystem::path& path) {
  const Ball ball =
      capture.has_masks ? locate_by_masks(capture, path) : locate_by_cameras(capture, points, path);
  if (!(ball.radius > 0) || !std::isfinite(ball.radius)) {
    throw InputError(path, "the object has no size: all cameras are at the same point");
  }
  capture.normalization.scale = kFill / ball.radius;
  capture.normalization.centre = ball.centre;
  capture.object_radius = kFill;
  for (std::vector<View>* views : {&capture.train, &capture.test}) {
    for (View& view : *views) view.camera = capture.normalization.to_inside(view.camera);
  }
}

}  // namespace tt3d::capture
