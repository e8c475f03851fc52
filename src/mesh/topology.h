#pragma once

#include <array>
#include <cstdint>
#include <numeric>
#include <vector>

#include "tt3d/mesh.h"

/// Index-structure helpers of the mesh room.
namespace tt3d::mesh {

using Face = std::array<int32_t, 3>;
using Point = std::array<float, 3>;

std::vector<Face> faces_of(const TriMesh& m);
std::vector<Point> points_of(const TriMesh& m);
TriMesh make_mesh(const std::vector<Point>& points, const std::vector<Face>& faces);
/// The same with unused points dropped and the rest numbered by first use.
TriMesh compact(const std::vector<Point>& points, const std::vector<Face>& faces);
/// One number for an undirected edge.
uint64_t edge_key(int32_t a, int32_t b);

/// Disjoint sets with path halving; the root is the smallest member.
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
