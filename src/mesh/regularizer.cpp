#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>
#include <nanoflann.hpp>
#include <utility>
#include <vector>

#include "nearest_math.h"
#include "neighbors.h"
#include "topology.h"
#include "tt3d/device.h"
#include "tt3d/mesh.h"
#include "tt3d/surface.h"

namespace tt3d::mesh {

using at::Tensor;

/// The rest positions [V,3] on the host, in a k-d tree.
struct MeshRegularizer::RestTree {
  /// nanoflann's adaptor for [V,3] float points.
  struct Cloud {
    const float* p;
    size_t n;
    [[nodiscard]] size_t kdtree_get_point_count() const { return n; }
    [[nodiscard]] float kdtree_get_pt(size_t i, size_t k) const { return p[3 * i + k]; }
    template <class Box>
    bool kdtree_get_bbox(Box&) const {
      return false;
    }
  };
  using Tree = nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<float, Cloud>,
                                                   Cloud, 3, int64_t>;

  explicit RestTree(const Tensor& rest)
      : points(rest.cpu().to(at::kFloat).contiguous()),
        cloud{points.const_data_ptr<float>(), static_cast<size_t>(points.size(0))},
        tree(3, cloud, {16}) {}
  RestTree(const RestTree&) = delete;
  RestTree& operator=(const RestTree&) = delete;

  /// The nearest rest position, and the distance to the `rank`-th nearest (0: the nearest).
  [[nodiscard]] std::pair<int64_t, float> nearest(const float* query, size_t rank) const {
    int64_t found[2] = {0, 0};
    float squared[2] = {0, 0};
    const size_t count = tree.knnSearch(query, rank + 1, found, squared);
    return {found[0], std::sqrt(squared[count - 1])};
  }

  Tensor points;
  Cloud cloud;
  Tree tree;
};

namespace {

/// Collects the points within a radius for nanoflann, whose own class for it differs by version.
class Within {
 public:
  using DistanceType = float;
  using IndexType = int64_t;
  Within(float squared_radius, std::vector<std::pair<int64_t, float>>& found)
      : squared_radius_(squared_radius), found_(&found) {
    found.clear();
  }
  bool addPoint(float squared, int64_t index) {
    if (squared < squared_radius_) found_->emplace_back(index, squared);
    return true;
  }
  [[nodiscard]] float worstDist() const { return squared_radius_; }
  [[nodiscard]] size_t size() const { return found_->size(); }
  [[nodiscard]] bool full() const { return true; }
  [[nodiscard]] bool empty() const { return found_->empty(); }
  /// The nearest first.
  void sort() {
    std::sort(found_->begin(), found_->end(),
              [](const auto& a, const auto& b) { return a.second < b.second; });
  }

 private:
  float squared_radius_;
  std::vector<std::pair<int64_t, float>>* found_;
};

float squared_distance(const float* a, const float* b) {
  const float x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
  return x * x + y * y + z * z;
}

/// For each query: find(i), or its own index if `own` says so. [Q] int64.
template <typename Find>
Tensor nearest_indices(const Tensor& own, const Find& find) {
  Tensor index = at::arange(own.size(0), at::kLong);
  auto* out = index.mutable_data_ptr<int64_t>();
  const auto* known = own.const_data_ptr<bool>();
  for_each_index(own.size(0), [&](int64_t i) {
    if (!known[i]) out[i] = find(i);
  });
  return index;
}

/// The same on the GPU, by comparison with all points.
Tensor nearest_by_comparison(const Tensor& queries, const Tensor& points, const Tensor& own) {
  Tensor index = at::empty({queries.size(0)}, queries.options().dtype(at::kLong));
  for_each_index_on(
      queries, queries.size(0),
      mesh::NearestPoint{queries.const_data_ptr<float>(), points.const_data_ptr<float>(),
                         points.size(0), own.const_data_ptr<bool>(),
                         index.mutable_data_ptr<int64_t>()});
  return index;
}

/// Keys of the undirected edges, each once, sorted.
std::vector<uint64_t> edge_keys(const scene::TriMesh& m) {
  std::vector<uint64_t> keys;
  for (const mesh::Face& f : mesh::faces_of(m)) {
    for (int k = 0; k < 3; ++k) keys.push_back(mesh::edge_key(f[k], f[(k + 1) % 3]));
  }
  std::sort(keys.begin(), keys.end());
  keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
  return keys;
}

/// The edges' vertices, [E,2] int64.
Tensor edge_vertices(const std::vector<uint64_t>& keys) {
  Tensor edges = at::empty({static_cast<int64_t>(keys.size()), 2}, at::kLong);
  auto* p = edges.mutable_data_ptr<int64_t>();
  for (const uint64_t key : keys) {
    *p++ = static_cast<int64_t>(key >> 32);
    *p++ = static_cast<int64_t>(key & 0xFFFFFFFFU);
  }
  return edges;
}

/// Half the cotangent of the angle at corner k of a face; huge for a degenerate one, with its sign.
double half_cotangent(const std::vector<mesh::Point>& points, const mesh::Face& f, int k) {
  const mesh::Point &o = points[f[k]], &a = points[f[(k + 1) % 3]], &b = points[f[(k + 2) % 3]];
  double dot = 0, aa = 0, bb = 0;
  for (int i = 0; i < 3; ++i) {
    const double u = double{a[i]} - double{o[i]}, v = double{b[i]} - double{o[i]};
    dot += u * v;
    aa += u * u;
    bb += v * v;
  }
  const double sine = std::sqrt(std::max(aa * bb - dot * dot, 0.0));
  return 0.5 * dot / std::max(sine, 1e-30);
}

/// Cotangent weights [E] float64, in the order of `keys`.
Tensor cotangent_weights(const scene::TriMesh& m, const std::vector<uint64_t>& keys) {
  constexpr double kLeast = 1e-4, kMost = 1e2;  // bounds for obtuse and degenerate triangles
  std::vector<double> sums(keys.size(), 0.0);
  const auto points = mesh::points_of(m);
  for (const mesh::Face& f : mesh::faces_of(m)) {
    for (int k = 0; k < 3; ++k) {
      const uint64_t opposite = mesh::edge_key(f[(k + 1) % 3], f[(k + 2) % 3]);
      const auto edge = std::lower_bound(keys.begin(), keys.end(), opposite) - keys.begin();
      sums[edge] += half_cotangent(points, f, k);
    }
  }
  return at::tensor(sums, at::kDouble).clamp(kLeast, kMost);
}

}  // namespace

MeshRegularizer::MeshRegularizer(const scene::TriMesh& rest, LaplacianWeights weights)
    : rest_(rest.vertices.detach().contiguous()) {
  const auto keys = edge_keys(rest);
  const Tensor edges = edge_vertices(keys);
  Tensor own;
  if (weights == LaplacianWeights::kCotangent) own = cotangent_weights(rest, keys);
  const Tensor shares = own.defined() ? own : at::ones({edges.size(0)}, at::kDouble);
  neighbors_ = std::make_shared<mesh::Neighbors>(edges, own, rest_.size(0), rest_.options());
  degree_ = at::zeros({rest_.size(0)}, at::kDouble)
                .index_add(0, edges.select(1, 0), shares)
                .index_add(0, edges.select(1, 1), shares)
                .clamp_min(own.defined() ? 1e-4 : 1)
                .unsqueeze(1)
                .to(rest_.options());
  tree_ = std::make_shared<RestTree>(rest_);
  Tensor spacing = at::empty({rest_.size(0)});
  const float* points = tree_->points.const_data_ptr<float>();
  auto* out = spacing.mutable_data_ptr<float>();
  for_each_index(rest_.size(0),
                 [&](int64_t i) { out[i] = tree_->nearest(points + 3 * i, 1).second; });
  spacing_ = spacing.to(rest_.options());
}

/// The nearest rest position of each moved vertex, and the nearest moved vertex of each rest
/// position: [V] int64 each.
std::pair<Tensor, Tensor> MeshRegularizer::nearest_both_ways(const Tensor& moved,
                                                             const Tensor& offset) const {
  // If a vertex moved less than half its spacing, its own rest position is the nearest. If the
  // spacing of a rest position exceeds its own vertex's move plus the largest move, its own vertex
  // is the nearest.
  const Tensor largest_offset = offset.max();
  const Tensor rest_known = offset * 2 < spacing_,
               vertex_known = offset + largest_offset < spacing_;
  if (!moved.is_cpu()) {
    return {nearest_by_comparison(moved, rest_, rest_known),
            nearest_by_comparison(rest_, moved, vertex_known)};
  }
  const Tensor positions = moved.to(at::kFloat), offsets = offset.to(at::kFloat);
  const float *position = positions.const_data_ptr<float>(),
              *moved_by = offsets.const_data_ptr<float>();
  const float largest = largest_offset.item<float>();
  const Tensor to_rest = nearest_indices(
      rest_known, [&](int64_t i) { return tree_->nearest(position + 3 * i, 0).first; });
  const float* rest = tree_->points.const_data_ptr<float>();
  const Tensor to_vertex = nearest_indices(vertex_known, [&](int64_t i) {
    // A vertex that is nearer must have its rest position within the sum of both moves.
    const float radius = (moved_by[i] + largest) * 1.0001F;
    thread_local std::vector<std::pair<int64_t, float>> around;  // reuses its memory
    Within within(radius * radius, around);
    tree_->tree.radiusSearchCustomCallback(rest + 3 * i, within);
    within.sort();
    int64_t found = i;
    float least = squared_distance(position + 3 * i, rest + 3 * i);
    for (const auto& [vertex, unused] : around) {
      const float squared = squared_distance(position + 3 * vertex, rest + 3 * i);
      if (squared < least) {
        least = squared;
        found = vertex;
      }
    }
    return found;
  });
  return {to_rest, to_vertex};
}

Tensor MeshRegularizer::laplacian(const Tensor& vertices) const {
  return (mesh::neighbor_differences(vertices, neighbors_) / degree_).square().sum(1).mean();
}

Tensor MeshRegularizer::edge_length(const Tensor& vertices) const {
  return mesh::mean_squared_edge(vertices, neighbors_);
}

Tensor MeshRegularizer::chamfer(const Tensor& vertices) const {
  const Tensor moved = vertices.detach().contiguous();
  const Tensor offset = (moved - rest_).norm(2, {1});
  const auto [to_rest, to_vertex] = nearest_both_ways(moved, offset);
  return (vertices - rest_.index_select(0, to_rest)).square().sum(1).mean() +
         (vertices.index_select(0, to_vertex) - rest_).square().sum(1).mean();
}

}  // namespace tt3d::mesh
