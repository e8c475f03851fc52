#pragma once

#include <vector>

#include "linear.h"
#include "tt3d/capture.h"

namespace tt3d {

/// A ball around something.
struct Ball {
  linear::Vec3 centre{};
  double radius = 0;  ///< 0: nothing there
};

/// The mask of a view, reduced to a coarse grid of cells that holds counts of object cells in all
/// rectangles from the corner (a summed-area table), so that "is there object near this pixel"
/// takes four look-ups.
class Silhouette {
 public:
  explicit Silhouette(const View& view);

  enum class Answer { kUnseen, kEmpty, kObject };
  /// What the view shows within `radius` world units of a world point.
  [[nodiscard]] Answer ask(const linear::Vec3& point, double radius) const;
  [[nodiscard]] bool empty() const { return sums_.back() == 0; }
  /// Unit direction in the world through the middle of the mask's bounding box.
  [[nodiscard]] linear::Vec3 direction() const;
  /// Bound on the tangent of the angle between direction() and the edge of the mask.
  [[nodiscard]] double spread() const;
  [[nodiscard]] linear::Vec3 position() const { return camera_.position(); }

 private:
  struct Box {
    int left, top, right, bottom;  ///< cells, right and bottom exclusive
  };
  void mark_cells(const View& view, std::vector<uint8_t>& cells) const;
  [[nodiscard]] uint32_t count(const Box& box) const;

  Camera camera_;
  int columns_ = 0, rows_ = 0;
  std::vector<uint32_t> sums_;  ///< [rows+1, columns+1]
  Box bounds_{};                ///< of the object's cells
};

/// Ball around the visual hull (Laurentini 1994) of the silhouettes: space is carved on a coarse
/// grid within `search`, then again within what was left. Radius 0 if nothing is left.
[[nodiscard]] Ball carve_hull(const std::vector<Silhouette>& silhouettes, const Ball& search);

}  // namespace tt3d
