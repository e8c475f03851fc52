#include <ATen/ATen.h>

#include <cmath>
#include <nanoflann.hpp>

#include "nearest_math.h"
#include "topology.h"
#include "tt3d/device.h"
#include "tt3d/mesh.h"

namespace tt3d {
namespace {

using at::Tensor;

/// nanoflann's view of [V,3] float points.
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
using Tree = nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<float, Cloud>, Cloud,
                                                 3, int64_t>;

/// The `rank`-th nearest (0 the nearest) of `points` to each query: indices [Q] and distances.
std::pair<Tensor, Tensor> nearest(const Tensor& queries, const Tensor& points, int rank) {
  const Cloud cloud = {points.const_data_ptr<float>(), static_cast<size_t>(points.size(0))};
  const Tree tree(3, cloud, {16});
  Tensor index = at::zeros({queries.size(0)}, at::kLong), distance = at::zeros({queries.size(0)});
  auto* out = index.mutable_data_ptr<int64_t>();
  auto* out_distance = distance.mutable_data_ptr<float>();
  const auto* q = queries.const_data_ptr<float>();
  for_each_index(queries.size(0), [&](int64_t i) {
    int64_t found[2] = {0, 0};
    float squared[2] = {0, 0};
    const size_t count = tree.knnSearch(q + 3 * i, static_cast<size_t>(rank) + 1, found, squared);
    out[i] = found[count - 1];
    out_distance[i] = std::sqrt(squared[count - 1]);
  });
  return {index, distance};
}

/// The row of `values` of the point nearest to each query; where `own` [Q] holds, it is known to be
/// the query's own number.
Tensor rows_of_nearest(const Tensor& values, const Tensor& queries, const Tensor& points,
                       const Tensor& own) {
  if (queries.is_cpu()) {
    if (own.all().item<bool>()) return values;
    return values.index_select(0, nearest(queries, points, 0).first);
  }
  const Tensor index = at::empty({queries.size(0)}, queries.options().dtype(at::kLong));
  for_each_index_on(
      queries, queries.size(0),
      mesh::NearestPoint{queries.const_data_ptr<float>(), points.const_data_ptr<float>(),
                         points.size(0), own.const_data_ptr<bool>(),
                         index.mutable_data_ptr<int64_t>()});
  return values.index_select(0, index);
}

/// Unique undirected edges [E,2] int64, in order of first appearance.
Tensor unique_edges(const TriMesh& m) {
  std::vector<uint64_t> keys;
  for (const mesh::Face& f : mesh::faces_of(m)) {
    for (int k = 0; k < 3; ++k) keys.push_back(mesh::edge_key(f[k], f[(k + 1) % 3]));
  }
  std::sort(keys.begin(), keys.end());
  keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
  Tensor edges = at::empty({static_cast<int64_t>(keys.size()), 2}, at::kLong);
  auto* p = edges.mutable_data_ptr<int64_t>();
  for (const uint64_t key : keys) {
    *p++ = static_cast<int64_t>(key >> 32);
    *p++ = static_cast<int64_t>(key & 0xFFFFFFFFU);
  }
  return edges;
}

}  // namespace

MeshRegularizer::MeshRegularizer(const TriMesh& rest) : rest_(rest.vertices.detach().contiguous()) {
  edges_ = unique_edges(rest).to(rest_.device());
  degree_ = at::zeros({rest_.size(0)}, rest_.options());
  degree_.index_add_(0, edges_.flatten(), at::ones({edges_.numel()}, rest_.options()));
  degree_ = degree_.clamp_min(1).unsqueeze(1);
  const Tensor on_host = rest_.cpu();
  spacing_ = nearest(on_host, on_host, 1).second.to(rest_.device());
}

Tensor MeshRegularizer::laplacian(const Tensor& vertices) const {
  const Tensor a = edges_.select(1, 0), b = edges_.select(1, 1);
  const Tensor sums = at::zeros_like(rest_)
                          .index_add(0, a, vertices.index_select(0, b))
                          .index_add(0, b, vertices.index_select(0, a));
  return (vertices - sums / degree_).square().sum(1).mean();
}

Tensor MeshRegularizer::edge_length(const Tensor& vertices) const {
  return (vertices.index_select(0, edges_.select(1, 0)) -
          vertices.index_select(0, edges_.select(1, 1)))
      .square()
      .sum(1)
      .mean();
}

Tensor MeshRegularizer::chamfer(const Tensor& vertices) const {
  const Tensor moved = vertices.detach().contiguous();
  const Tensor offset = (moved - rest_).norm(2, {1});
  // A vertex that moved less than half its spacing has its own rest place as the nearest; a rest
  // place whose spacing exceeds its own move and the largest one has its own vertex nearest.
  const Tensor to_rest = rows_of_nearest(rest_, moved, rest_, offset * 2 < spacing_);
  const Tensor to_vertex =
      rows_of_nearest(vertices, rest_, moved, offset + offset.max() < spacing_);
  return (vertices - to_rest).square().sum(1).mean() + (to_vertex - rest_).square().sum(1).mean();
}

}  // namespace tt3d
