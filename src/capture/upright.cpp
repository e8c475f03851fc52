#include "upright.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace tt3d::capture {

using namespace scene::linear;

namespace {

constexpr double kDegree = std::numbers::pi / 180;
/// A COLMAP world within this angle of upright was aligned by its maker and is kept.
constexpr double kAligned = 5 * kDegree;
/// Roll at which a camera counts half.
constexpr double kRoll = 5 * kDegree;

/// Solves the symmetric system (a + shift I) x = b by Cramer's rule.
Vec3 solve(const std::array<Vec3, 3>& a, double shift, const Vec3& b) {
  std::array<Vec3, 3> m = a;
  for (size_t k = 0; k < 3; ++k) m[k][k] += shift;
  const double determinant = dot(cross(m[0], m[1]), m[2]);
  return {dot(cross(b, m[1]), m[2]) / determinant, dot(cross(m[0], b), m[2]) / determinant,
          dot(cross(m[0], m[1]), b) / determinant};
}

/// Sum of w x x^T over the cameras' x axes.
std::array<Vec3, 3> moments(const std::vector<scene::Camera>& cameras, const Vec3& up,
                            bool weighted) {
  std::array<Vec3, 3> sum{};
  double total = 0;
  for (const scene::Camera& camera : cameras) {
    const Vec3 x = column(camera.camera_to_world, 0);
    const double roll = dot(x, up) / std::sin(kRoll);
    const double weight = weighted ? 1 / (1 + roll * roll) : 1;
    for (size_t k = 0; k < 3; ++k) sum[k] = sum[k] + weight * x[k] * x;
    total += weight;
  }
  for (Vec3& row : sum) row = (1 / total) * row;
  return sum;
}

}  // namespace

Vec3 up_of_cameras(const std::vector<scene::Camera>& cameras) {
  Vec3 mean{};
  for (const scene::Camera& camera : cameras) mean = mean + column(camera.camera_to_world, 1);
  if (length(mean) < 1e-9) return {0, 0, 1};
  mean = normalized(mean);
  Vec3 up = mean;
  for (int pass = 0; pass < 10; ++pass) {
    const std::array<Vec3, 3> a = moments(cameras, up, pass > 0);
    // Inverse iteration finds the direction with the smallest moment.
    for (int i = 0; i < 30; ++i) up = normalized(solve(a, 1e-6, up));
    const Vec3 across = {dot(a[0], up), dot(a[1], up), dot(a[2], up)};
    const double smallest = dot(across, up);
    const double trace = a[0][0] + a[1][1] + a[2][2];
    // The middle moment: 0 if all x axes are parallel.
    double squares = 0;
    for (const Vec3& row : a) squares += dot(row, row);
    const double rest = trace - smallest;
    const double middle =
        0.5 * (rest - std::sqrt(std::max(0.0, 2 * (squares - smallest * smallest) - rest * rest)));
    if (middle < 0.1) return mean;
  }
  if (dot(up, mean) < 0) up = -1.0 * up;
  return dot(up, mean) < std::cos(40 * kDegree) ? mean : up;
}

Vec3 up_of_capture(UpDirection option, CaptureFormat format, const RawCapture& raw,
                   Progress& progress) {
  constexpr Vec3 kZ = {0, 0, 1};
  if (option != UpDirection::kAuto) {
    constexpr Vec3 kAxes[] = {{1, 0, 0}, {0, 1, 0}, kZ, {-1, 0, 0}, {0, -1, 0}, {0, 0, -1}};
    return kAxes[static_cast<size_t>(option) - 1];
  }
  if (format != CaptureFormat::kColmap || raw.upright) return kZ;
  std::vector<scene::Camera> cameras;
  for (const auto* views : {&raw.train, &raw.test}) {
    for (const RawView& view : *views) cameras.push_back(view.camera);
  }
  const Vec3 up = up_of_cameras(cameras);
  const double angle = std::acos(std::clamp(up[2], -1.0, 1.0));
  if (angle < kAligned) return kZ;
  progress.note("the world of the cameras is turned by " +
                std::to_string(std::lround(angle / kDegree)) +
                " degrees, so that the cameras' up direction is +Z; capture.up sets another one");
  return up;
}

}  // namespace tt3d::capture
