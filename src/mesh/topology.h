#pragma once

#include <array>
#include <cstdint>
#include <numeric>
#include <vector>

#include "tt3d/mesh.h"
#include "tt3d/surface.h"

/// Conversions and index structures of the mesh room.
namespace tt3d::mesh {

using Face = std::array<int32_t, 3>;
using Point = std::array<float, 3>;

std::vector<Face> faces_of(const scene::TriMesh& m);
std::vector<Point> points_of(const scene::TriMesh& m);
scene::TriMesh make_mesh(const std::vector<Point>& points, const std::vector<Face>& faces);
/// The same, but without unused points; the others are renumbered in order of first use.
scene::TriMesh compact(const std::vector<Point>& points, const std::vector<Face>& faces);
/// A key for an undirected edge.
uint64_t edge_key(int32_t a, int32_t b);

/// Disjoint sets with path halving; the representative is the smallest member.
class UnionFind {
 public:
  explicit UnionFind(size_t n) : parent_(n) { std::iota(parent_.begin(), parent_.end(), 0); }
  int32_t find(int32_t i) {
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }
  void join(int32_t a, int32_t b) {
    const int32_t x = find(a), y = find(b);
    parent_[std::max(x, y)] = std::min(x, y);
  }

 private:
  std::vector<int32_t> parent_;
};

}  // namespace tt3d::mesh
