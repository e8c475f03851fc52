#include <ATen/ATen.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numeric>
#include <unordered_map>

#include "topology.h"
#include "tt3d/mesh.h"
#include "tt3d/surface.h"

namespace tt3d::mesh {

std::vector<Face> faces_of(const scene::TriMesh& m) {
  const at::Tensor dense = m.faces.cpu().contiguous();
  const auto* p = dense.const_data_ptr<int32_t>();
  std::vector<Face> faces(static_cast<size_t>(dense.size(0)));
  for (size_t i = 0; i < faces.size(); ++i) faces[i] = {p[3 * i], p[3 * i + 1], p[3 * i + 2]};
  return faces;
}

std::vector<Point> points_of(const scene::TriMesh& m) {
  const at::Tensor dense = m.vertices.detach().cpu().to(at::kFloat).contiguous();
  const auto* p = dense.const_data_ptr<float>();
  std::vector<Point> points(static_cast<size_t>(dense.size(0)));
  for (size_t i = 0; i < points.size(); ++i) points[i] = {p[3 * i], p[3 * i + 1], p[3 * i + 2]};
  return points;
}

scene::TriMesh make_mesh(const std::vector<Point>& points, const std::vector<Face>& faces) {
  const auto v = static_cast<int64_t>(points.size()), f = static_cast<int64_t>(faces.size());
  scene::TriMesh m = {at::empty({v, 3}), at::empty({f, 3}, at::kInt)};
  if (v > 0) std::copy_n(points[0].data(), 3 * v, m.vertices.mutable_data_ptr<float>());
  if (f > 0) std::copy_n(faces[0].data(), 3 * f, m.faces.mutable_data_ptr<int32_t>());
  return m;
}

scene::TriMesh compact(const std::vector<Point>& points, const std::vector<Face>& faces) {
  std::vector<int32_t> renumbered(points.size(), -1);
  std::vector<Point> used;
  std::vector<Face> out = faces;
  for (Face& f : out) {
    for (int32_t& v : f) {
      if (renumbered[v] < 0) {
        renumbered[v] = static_cast<int32_t>(used.size());
        used.push_back(points[v]);
      }
      v = renumbered[v];
    }
  }
  return make_mesh(used, out);
}

uint64_t edge_key(int32_t a, int32_t b) {
  return (static_cast<uint64_t>(std::min(a, b)) << 32) | static_cast<uint64_t>(std::max(a, b));
}

namespace {

/// Faces at an edge: how many traverse it from the lower to the higher index, and how many back.
struct EdgeUse {
  int forward = 0, backward = 0;
};

std::unordered_map<uint64_t, EdgeUse> edge_uses(const std::vector<Face>& faces) {
  std::unordered_map<uint64_t, EdgeUse> uses;
  uses.reserve(faces.size() * 3 / 2);
  for (const Face& f : faces) {
    for (int k = 0; k < 3; ++k) {
      const int32_t a = f[k], b = f[(k + 1) % 3];
      EdgeUse& use = uses[mesh::edge_key(a, b)];
      ++(a < b ? use.forward : use.backward);
    }
  }
  return uses;
}

}  // namespace

MeshFacts inspect(const scene::TriMesh& m) {
  const auto faces = mesh::faces_of(m);
  const auto points = mesh::points_of(m);
  MeshFacts facts;
  facts.vertices = static_cast<int64_t>(points.size());
  facts.faces = static_cast<int64_t>(faces.size());
  const auto uses = edge_uses(faces);
  facts.edges = static_cast<int64_t>(uses.size());
  for (const auto& [key, use] : uses) {
    if (use.forward + use.backward == 1)
      ++facts.boundary_edges;
    else if (use.forward != 1 || use.backward != 1)
      ++facts.non_manifold_edges;
  }
  facts.euler = facts.vertices - facts.edges + facts.faces;
  UnionFind sets(points.size());
  std::vector<uint8_t> used(points.size(), 0);
  for (const Face& f : faces) {
    sets.join(f[0], f[1]);
    sets.join(f[1], f[2]);
    for (const int32_t v : f) used[v] = 1;
    const mesh::Point &a = points[f[0]], &b = points[f[1]], &c = points[f[2]];
    facts.volume += (double(a[0]) * (double(b[1]) * c[2] - double(b[2]) * c[1]) -
                     double(a[1]) * (double(b[0]) * c[2] - double(b[2]) * c[0]) +
                     double(a[2]) * (double(b[0]) * c[1] - double(b[1]) * c[0])) /
                    6;
  }
  for (size_t v = 0; v < points.size(); ++v) {
    facts.components += used[v] && sets.find(static_cast<int32_t>(v)) == static_cast<int32_t>(v);
  }
  return facts;
}

scene::TriMesh drop_small_components(const scene::TriMesh& m, double share) {
  const auto faces = mesh::faces_of(m);
  const auto points = mesh::points_of(m);
  UnionFind sets(points.size());
  for (const Face& f : faces) {
    sets.join(f[0], f[1]);
    sets.join(f[1], f[2]);
  }
  struct Box {
    mesh::Point low{1e30F, 1e30F, 1e30F}, high{-1e30F, -1e30F, -1e30F};
    void add(const mesh::Point& p) {
      for (int k = 0; k < 3; ++k) {
        low[k] = std::min(low[k], p[k]);
        high[k] = std::max(high[k], p[k]);
      }
    }
    [[nodiscard]] double diagonal() const {
      return std::hypot(high[0] - low[0], high[1] - low[1], high[2] - low[2]);
    }
  };
  Box whole;
  std::unordered_map<int32_t, Box> boxes;
  for (const Face& f : faces) {
    for (const int32_t v : f) {
      whole.add(points[v]);
      boxes[sets.find(v)].add(points[v]);
    }
  }
  std::vector<Face> kept;
  for (const Face& f : faces) {
    if (boxes[sets.find(f[0])].diagonal() >= share * whole.diagonal()) kept.push_back(f);
  }
  return mesh::compact(points, kept);
}

}  // namespace tt3d::mesh
