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
    const auto found = nearest(queries.to(at::kFloat), points.to(at::kFloat), 0);
    return values.index_select(0, found.first);
  }
  const Tensor index = at::empty({queries.size(0)}, queries.options().dtype(at::kLong));
  for_each_index_on(
      queries, queries.size(0),
      mesh::NearestPoint{queries.const_data_ptr<float>(), points.const_data_ptr<float>(),
                         points.size(0), own.const_data_ptr<bool>(),
                         index.mutable_data_ptr<int64_t>()});
  return values.index_select(0, index);
}

/// Keys of the undirected edges, each once, in order.
std::vector<uint64_t> edge_keys(const TriMesh& m) {
  std::vector<uint64_t> keys;
  for (const mesh::Face& f : mesh::faces_of(m)) {
    for (int k = 0; k < 3; ++k) keys.push_back(mesh::edge_key(f[k], f[(k + 1) % 3]));
  }
  std::sort(keys.begin(), keys.end());
  keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
  return keys;
}

/// Their vertices, [E,2] int64.
Tensor edge_vertices(const std::vector<uint64_t>& keys) {
  Tensor edges = at::empty({static_cast<int64_t>(keys.size()), 2}, at::kLong);
  auto* p = edges.mutable_data_ptr<int64_t>();
  for (const uint64_t key : keys) {
    *p++ = static_cast<int64_t>(key >> 32);
    *p++ = static_cast<int64_t>(key & 0xFFFFFFFFU);
  }
  return edges;
}

/// Half the cotangent of the angle at corner k of a face; huge for a needle, by its sign.
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

/// Cotangent weights of the edges [E,1], in their order.
Tensor cotangent_weights(const TriMesh& m, const std::vector<uint64_t>& keys) {
  constexpr double kLeast = 1e-4, kMost = 1e2;  // obtuse pairs and needles
  std::vector<double> sums(keys.size(), 0.0);
  const auto points = mesh::points_of(m);
  for (const mesh::Face& f : mesh::faces_of(m)) {
    for (int k = 0; k < 3; ++k) {
      const uint64_t opposite = mesh::edge_key(f[(k + 1) % 3], f[(k + 2) % 3]);
      const auto edge = std::lower_bound(keys.begin(), keys.end(), opposite) - keys.begin();
      sums[edge] += half_cotangent(points, f, k);
    }
  }
  return at::tensor(sums, at::kDouble).clamp(kLeast, kMost).unsqueeze(1);
}

}  // namespace

MeshRegularizer::MeshRegularizer(const TriMesh& rest, LaplacianWeights weights)
    : rest_(rest.vertices.detach().contiguous()) {
  const auto keys = edge_keys(rest);
  edges_ = edge_vertices(keys).to(rest_.device());
  Tensor shares = at::ones({edges_.numel()}, rest_.options());
  if (weights == LaplacianWeights::kCotangent) {
    weights_ = cotangent_weights(rest, keys).to(rest_.options());
    shares = weights_.expand({-1, 2}).reshape({-1});
  }
  degree_ = at::zeros({rest_.size(0)}, rest_.options()).index_add_(0, edges_.flatten(), shares);
  degree_ = degree_.clamp_min(weights_.defined() ? 1e-4 : 1).unsqueeze(1);
  const Tensor on_host = rest_.cpu().to(at::kFloat);
  spacing_ = nearest(on_host, on_host, 1).second.to(rest_.options());
}

Tensor MeshRegularizer::laplacian(const Tensor& vertices) const {
  const Tensor a = edges_.select(1, 0), b = edges_.select(1, 1);
  const auto weighted = [&](const Tensor& x) { return weights_.defined() ? x * weights_ : x; };
  const Tensor sums = at::zeros_like(rest_)
                          .index_add(0, a, weighted(vertices.index_select(0, b)))
                          .index_add(0, b, weighted(vertices.index_select(0, a)));
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
