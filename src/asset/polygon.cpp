#include <algorithm>
#include <cmath>

#include "asset_source.h"

namespace tt3d::asset {
namespace {

using Point = std::array<double, 2>;
using Triangle = std::array<size_t, 3>;

/// Twice the signed area of a triangle; positive if it is counter-clockwise.
double area(const Point& a, const Point& b, const Point& c) {
  return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
}

/// A polygon in the plane, counter-clockwise.
struct Flat {
  std::vector<Point> points;
  double rounding = 0;  ///< triangles of this area count as flat
};

/// The corners in the coordinate plane that shows most of the polygon. No points if it has no area.
Flat project(const std::vector<std::array<double, 3>>& corners) {
  const auto& origin = corners[0];  // relative to it, to keep the digits of far coordinates
  std::array<double, 3> normal{};   // Newell's method
  for (size_t i = 0; i < corners.size(); ++i) {
    const auto &p = corners[i], &q = corners[(i + 1) % corners.size()];
    for (size_t k = 0; k < 3; ++k) {
      const size_t u = (k + 1) % 3, v = (k + 2) % 3;
      normal[k] +=
          (p[u] - origin[u]) * (q[v] - origin[v]) - (p[v] - origin[v]) * (q[u] - origin[u]);
    }
  }
  size_t axis = 0;
  for (size_t k = 1; k < 3; ++k) {
    if (std::abs(normal[k]) > std::abs(normal[axis])) axis = k;
  }
  if (!(std::abs(normal[axis]) > 0)) return {};
  size_t u = (axis + 1) % 3, v = (axis + 2) % 3;
  if (normal[axis] < 0) std::swap(u, v);
  Flat flat;
  flat.rounding = 1e-12 * std::abs(normal[axis]);
  flat.points.reserve(corners.size());
  for (const auto& p : corners) flat.points.push_back({p[u] - origin[u], p[v] - origin[v]});
  return flat;
}

std::vector<Triangle> fan(size_t corners) {
  std::vector<Triangle> triangles;
  triangles.reserve(corners - 2);
  for (size_t i = 2; i < corners; ++i) triangles.push_back({0, i - 1, i});
  return triangles;
}

/// True if no triangle of the fan is turned over.
bool fan_fits(const Flat& flat) {
  const std::vector<Point>& points = flat.points;
  for (size_t i = 2; i < points.size(); ++i) {
    if (area(points[0], points[i - 1], points[i]) < -flat.rounding) return false;
  }
  return true;
}

/// Cuts ears off a counter-clockwise polygon. The remaining corners form a linked list.
class EarClipper {
 public:
  explicit EarClipper(const Flat& flat)
      : points_(flat.points),
        rounding_(flat.rounding),
        previous_(points_.size()),
        next_(points_.size()) {
    const size_t n = points_.size();
    for (size_t i = 0; i < n; ++i) {
      previous_[i] = (i + n - 1) % n;
      next_[i] = (i + 1) % n;
    }
  }

  /// nullopt if a remaining polygon has no ear, because the polygon crosses itself.
  std::optional<std::vector<Triangle>> clip() {
    std::vector<Triangle> triangles;
    size_t corner = 0, left = points_.size(), tried = 0;
    bool allow_flat = false;  // corners on a line are cut off when no other ear is left
    while (left > 3) {
      if (is_ear(corner, allow_flat)) {
        triangles.push_back({previous_[corner], corner, next_[corner]});
        next_[previous_[corner]] = next_[corner];
        previous_[next_[corner]] = previous_[corner];
        --left;
        tried = 0;
        allow_flat = false;
      } else if (++tried > left) {
        if (allow_flat) return std::nullopt;
        allow_flat = true;
        tried = 0;
      }
      corner = next_[corner];
    }
    triangles.push_back({previous_[corner], corner, next_[corner]});
    return triangles;
  }

 private:
  [[nodiscard]] double turn(size_t corner) const {
    return area(points_[previous_[corner]], points_[corner], points_[next_[corner]]);
  }

  /// True if the corner is convex and no other corner lies in its triangle.
  [[nodiscard]] bool is_ear(size_t corner, bool allow_flat) const {
    const double size = turn(corner);
    if (size <= rounding_) return allow_flat && size >= -rounding_;
    const Point &a = points_[previous_[corner]], &b = points_[corner], &c = points_[next_[corner]];
    for (size_t i = next_[next_[corner]]; i != previous_[corner]; i = next_[i]) {
      const Point& p = points_[i];
      // The two sides of a bridge to a hole have corners at the same place.
      if (p == a || p == b || p == c) continue;
      if (area(a, b, p) >= 0 && area(b, c, p) >= 0 && area(c, a, p) >= 0) return false;
    }
    return true;
  }

  const std::vector<Point>& points_;
  double rounding_;
  std::vector<size_t> previous_, next_;
};

}  // namespace

std::optional<std::vector<Triangle>> triangulate(
    const std::vector<std::array<double, 3>>& corners) {
  if (corners.size() == 3) return fan(3);
  const Flat flat = project(corners);
  if (flat.points.empty() || fan_fits(flat)) return fan(corners.size());
  if (corners.size() > kMaxConcaveCorners) return std::nullopt;
  auto ears = EarClipper(flat).clip();
  return ears ? std::move(ears) : fan(corners.size());
}

}  // namespace tt3d::asset
