#include "visual_hull.h"
#include "tt3d/linear.h"

#include <ATen/ATen.h>
#include <ATen/Parallel.h>

#include <algorithm>
#include <limits>

namespace tt3d::capture {

using namespace scene::linear;

namespace {

constexpr int kCells = 256;                ///< cells along the longer side of a silhouette
constexpr uint8_t kObjectAlpha = 64;       ///< least alpha of a pixel that counts as object
constexpr int kVoxels = 64;                ///< side of the carving grid
constexpr double kToleratedMisses = 0.02;  ///< fraction of views that may be wrong about a voxel

struct Bounds {
  Vec3 low, high;
};

/// Keeps a voxel if at least half of all views see it, and nearly all of these show the object
/// there.
bool keep_voxel(const std::vector<Silhouette>& silhouettes, const Vec3& point, double radius) {
  const double views = static_cast<double>(silhouettes.size());
  int seen = 0;
  int misses = 0;
  for (const Silhouette& silhouette : silhouettes) {
    const Silhouette::Answer answer = silhouette.ask(point, radius);
    seen += answer == Silhouette::Answer::kUnseen ? 0 : 1;
    misses += answer == Silhouette::Answer::kEmpty ? 1 : 0;
    if (misses > kToleratedMisses * views) return false;
  }
  return 2 * seen >= views && misses <= kToleratedMisses * seen;
}

Vec3 voxel_size(const Bounds& bounds) { return (1.0 / kVoxels) * (bounds.high - bounds.low); }

Vec3 voxel_centre(const Bounds& bounds, int64_t index) {
  const Vec3 size = voxel_size(bounds);
  const int64_t at[3] = {index % kVoxels, index / kVoxels % kVoxels, index / kVoxels / kVoxels};
  Vec3 centre;
  for (int a = 0; a < 3; ++a) {
    centre[a] = bounds.low[a] + (static_cast<double>(at[a]) + 0.5) * size[a];
  }
  return centre;
}

/// Centres of the voxels that carving keeps.
std::vector<Vec3> carve(const std::vector<Silhouette>& silhouettes, const Bounds& bounds) {
  constexpr int64_t kTotal = int64_t{kVoxels} * kVoxels * kVoxels;
  const double radius = 0.5 * length(voxel_size(bounds));
  std::vector<char> kept(kTotal);
  at::parallel_for(0, kTotal, 4096, [&](int64_t first, int64_t last) {
    for (int64_t i = first; i < last; ++i) {
      kept[static_cast<size_t>(i)] =
          keep_voxel(silhouettes, voxel_centre(bounds, i), radius) ? 1 : 0;
    }
  });
  std::vector<Vec3> centres;
  for (int64_t i = 0; i < kTotal; ++i) {
    if (kept[static_cast<size_t>(i)] != 0) centres.push_back(voxel_centre(bounds, i));
  }
  return centres;
}

Bounds bounds_of(const std::vector<Vec3>& points, const Vec3& margin) {
  constexpr double kFar = std::numeric_limits<double>::max();
  Bounds bounds{{kFar, kFar, kFar}, {-kFar, -kFar, -kFar}};
  for (const Vec3& point : points) {
    for (int a = 0; a < 3; ++a) {
      bounds.low[a] = std::min(bounds.low[a], point[a] - margin[a]);
      bounds.high[a] = std::max(bounds.high[a], point[a] + margin[a]);
    }
  }
  return bounds;
}

}  // namespace

Silhouette::Silhouette(const View& view) : camera_(view.camera) {
  const int longer = std::max(camera_.width, camera_.height);
  const int shrink = (longer + kCells - 1) / kCells;
  columns_ = (camera_.width + shrink - 1) / shrink;
  rows_ = (camera_.height + shrink - 1) / shrink;
  std::vector<uint8_t> cells(static_cast<size_t>(columns_) * rows_);
  mark_cells(view, cells);

  bounds_ = {columns_, rows_, 0, 0};
  const int pitch = columns_ + 1;
  sums_.assign(static_cast<size_t>(pitch) * (rows_ + 1), 0);
  for (int r = 0; r < rows_; ++r) {
    uint32_t row_sum = 0;
    for (int c = 0; c < columns_; ++c) {
      const bool object = cells[static_cast<size_t>(r) * columns_ + c] != 0;
      row_sum += object ? 1 : 0;
      sums_[static_cast<size_t>(r + 1) * pitch + c + 1] =
          sums_[static_cast<size_t>(r) * pitch + c + 1] + row_sum;
      if (!object) continue;
      bounds_ = {std::min(bounds_.left, c), std::min(bounds_.top, r),
                 std::max(bounds_.right, c + 1), std::max(bounds_.bottom, r + 1)};
    }
  }
}

void Silhouette::mark_cells(const View& view, std::vector<uint8_t>& cells) const {
  const at::Tensor rgba = view.rgba.contiguous();
  const uint8_t* alpha = rgba.data_ptr<uint8_t>() + 3;
  const int shrink = (camera_.width + columns_ - 1) / columns_;
  for (int y = 0; y < camera_.height; ++y) {
    for (int x = 0; x < camera_.width; ++x, alpha += 4) {
      if (*alpha < kObjectAlpha) continue;
      const int r = std::min(y / shrink, rows_ - 1);
      const int c = std::min(x / shrink, columns_ - 1);
      cells[static_cast<size_t>(r) * columns_ + c] = 1;
    }
  }
}

uint32_t Silhouette::count(const Box& box) const {
  const size_t pitch = static_cast<size_t>(columns_) + 1;
  const uint32_t* top = sums_.data() + box.top * pitch;
  const uint32_t* bottom = sums_.data() + box.bottom * pitch;
  return bottom[box.right] - bottom[box.left] - top[box.right] + top[box.left];
}

Silhouette::Answer Silhouette::ask(const Vec3& point, double radius) const {
  const Vec3 local = to_local(camera_.camera_to_world, point);
  const double depth = -local[2];
  if (depth <= radius) return Answer::kUnseen;
  const double columns_per_pixel = static_cast<double>(columns_) / camera_.width;
  const double rows_per_pixel = static_cast<double>(rows_) / camera_.height;
  const double u = (camera_.cx + camera_.fx * local[0] / depth) * columns_per_pixel;
  const double v = (camera_.cy - camera_.fy * local[1] / depth) * rows_per_pixel;
  const double du = camera_.fx * radius / depth * columns_per_pixel;
  const double dv = camera_.fy * radius / depth * rows_per_pixel;
  if (u + du <= 0 || v + dv <= 0 || u - du >= columns_ || v - dv >= rows_) return Answer::kUnseen;
  const Box box = {static_cast<int>(std::max(0.0, std::floor(u - du))),
                   static_cast<int>(std::max(0.0, std::floor(v - dv))),
                   static_cast<int>(std::min<double>(columns_, std::ceil(u + du))),
                   static_cast<int>(std::min<double>(rows_, std::ceil(v + dv)))};
  return count(box) > 0 ? Answer::kObject : Answer::kEmpty;
}

Vec3 Silhouette::direction() const {
  const double u = 0.5 * (bounds_.left + bounds_.right) * camera_.width / columns_;
  const double v = 0.5 * (bounds_.top + bounds_.bottom) * camera_.height / rows_;
  const Mat4& pose = camera_.camera_to_world;
  return normalized((u - camera_.cx) / camera_.fx * column(pose, 0) -
                    (v - camera_.cy) / camera_.fy * column(pose, 1) - column(pose, 2));
}

double Silhouette::spread() const {
  const double x = 0.5 * (bounds_.right - bounds_.left) * camera_.width / columns_ / camera_.fx;
  const double y = 0.5 * (bounds_.bottom - bounds_.top) * camera_.height / rows_ / camera_.fy;
  return std::hypot(x, y);
}

Ball carve_hull(const std::vector<Silhouette>& silhouettes, const Ball& search) {
  const Vec3 reach = {search.radius, search.radius, search.radius};
  Bounds bounds{search.centre - reach, search.centre + reach};
  std::vector<Vec3> kept;
  for (int pass = 0; pass < 2; ++pass) {
    kept = carve(silhouettes, bounds);
    if (kept.empty()) return {};
    // The next pass searches one voxel further; the last one ends at the voxels' faces.
    const Vec3 margin = (pass == 0 ? 1.0 : 0.5) * voxel_size(bounds);
    const double half_diagonal = 0.5 * length(voxel_size(bounds));
    bounds = bounds_of(kept, margin);
    if (pass == 0) continue;
    Ball ball{0.5 * (bounds.low + bounds.high), 0};
    for (const Vec3& point : kept) {
      ball.radius = std::max(ball.radius, length(point - ball.centre) + half_diagonal);
    }
    return ball;
  }
  return {};
}

}  // namespace tt3d::capture
