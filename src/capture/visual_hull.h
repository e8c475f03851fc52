#pragma once

#include <vector>

#include "tt3d/capture.h"
#include "tt3d/linear.h"
#include "tt3d/scene.h"

namespace tt3d::capture {

/// A ball that encloses an object.
struct Ball {
  scene::linear::Vec3 centre{};
  double radius = 0;  ///< 0: no object
};

/// A view's mask, reduced to a coarse grid of cells and stored as a summed-area table of object
/// cells. The question "is there object near this pixel" takes four look-ups.
class Silhouette {
 public:
  explicit Silhouette(const View& view);

  enum class Answer { kUnseen, kEmpty, kObject };
  /// What the view shows within `radius` world units of a world point.
  [[nodiscard]] Answer ask(const scene::linear::Vec3& point, double radius) const;
  [[nodiscard]] bool empty() const { return sums_.back() == 0; }
  /// Unit direction in the world through the middle of the mask's bounding box.
  [[nodiscard]] scene::linear::Vec3 direction() const;
  /// Upper bound on the tangent of the angle between direction() and the mask's edge.
  [[nodiscard]] double spread() const;
  [[nodiscard]] scene::linear::Vec3 position() const { return camera_.position(); }

 private:
  struct Box {
    int left, top, right, bottom;  ///< cells, right and bottom exclusive
  };
  void mark_cells(const View& view, std::vector<uint8_t>& cells) const;
  [[nodiscard]] uint32_t count(const Box& box) const;

  scene::Camera camera_;
  int columns_ = 0, rows_ = 0;
  std::vector<uint32_t> sums_;  ///< [rows+1, columns+1]
  Box bounds_{};                ///< of the object's cells
};

/// Ball around the visual hull (Laurentini 1994) of the silhouettes. Space is carved on a coarse
/// grid within `search`, then again within the remaining bounds. Radius 0 if nothing remains.
[[nodiscard]] Ball carve_hull(const std::vector<Silhouette>& silhouettes, const Ball& search);

}  // namespace tt3d::capture
