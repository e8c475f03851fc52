#include <ATen/ATen.h>

#include <algorithm>
#include <array>
#include <unordered_map>
#include <vector>

#include "tt3d/mesh.h"
#include "tt3d/surface.h"

namespace tt3d::mesh {
namespace {

// Corner c of a cube is at (c & 1, (c >> 1) & 1, (c >> 2) & 1).
struct CubeEdge {
  int a, b, axis;
};

/// The 12 edges; the lower corner first.
std::array<CubeEdge, 12> cube_edges() {
  std::array<CubeEdge, 12> edges{};
  int n = 0;
  for (int axis = 0; axis < 3; ++axis) {
    for (int c = 0; c < 8; ++c) {
      if (!((c >> axis) & 1)) edges[n++] = {c, c | (1 << axis), axis};
    }
  }
  return edges;
}

/// The 6 faces, with their corners counter-clockwise seen from outside.
constexpr int kFaces[6][4] = {{0, 4, 6, 2}, {1, 3, 7, 5}, {0, 1, 5, 4},
                              {2, 6, 7, 3}, {0, 2, 3, 1}, {4, 5, 7, 6}};

/// A polygon of the surface inside a cube, as the list of cube edges that hold its corners. `hub`
/// marks a polygon that needs an additional vertex in its middle.
struct Polygon {
  std::vector<int> edges;
  bool hub = false;
};

class CaseTable {
 public:
  CaseTable() : edges_(cube_edges()) {
    for (int mask = 0; mask < 256; ++mask) cases_[mask] = polygons_of(mask);
  }
  [[nodiscard]] const std::vector<Polygon>& polygons(int mask) const { return cases_[mask]; }
  [[nodiscard]] const CubeEdge& edge(int i) const { return edges_[i]; }

 private:
  [[nodiscard]] int edge_between(int a, int b) const {
    for (int i = 0; i < 12; ++i) {
      if ((edges_[i].a == a && edges_[i].b == b) || (edges_[i].a == b && edges_[i].b == a))
        return i;
    }
    return -1;
  }

  [[nodiscard]] bool share_face(int e, int f) const {
    for (const auto& face : kFaces) {
      const auto on = [&](int i) {
        int corners = 0;
        for (const int c : face) corners += c == edges_[i].a || c == edges_[i].b;
        return corners == 2;
      };
      if (on(e) && on(f)) return true;
    }
    return false;
  }

  /// Follows the directed segments where the surface meets the cube's faces. On each face, one
  /// segment cuts off each run of inside corners. An ambiguous face thus separates its inside
  /// corners, in the same way for both of its cubes.
  [[nodiscard]] std::vector<Polygon> polygons_of(int mask) const {
    std::array<int, 12> next{};
    next.fill(-1);
    for (const auto& face : kFaces) {
      for (int k = 0; k < 4; ++k) {
        const bool in = (mask >> face[k]) & 1, before = (mask >> face[(k + 3) % 4]) & 1;
        if (!in || before) continue;
        int last = k;  // follow the run of inside corners that starts at k
        while ((mask >> face[(last + 1) % 4]) & 1) last = (last + 1) % 4;
        const int entry = edge_between(face[(k + 3) % 4], face[k]);
        const int leave = edge_between(face[last], face[(last + 1) % 4]);
        next[entry] = leave;
      }
    }
    std::vector<Polygon> polygons;
    for (int start = 0; start < 12; ++start) {
      if (next[start] < 0) continue;
      Polygon polygon;
      for (int e = start; next[e] >= 0;) {
        polygon.edges.push_back(e);
        const int following = next[e];
        next[e] = -1;
        e = following;
      }
      choose_fan(polygon);
      polygons.push_back(polygon);
    }
    return polygons;
  }

  /// Rotates the polygon so that the diagonals of its fan do not lie on the cube's faces, where
  /// they could meet those of a neighbouring cube. A polygon without such a corner gets a hub.
  void choose_fan(Polygon& polygon) const {
    const size_t n = polygon.edges.size();
    for (size_t root = 0; root < n; ++root) {
      bool inside = true;
      for (size_t k = 2; k + 1 < n; ++k) {
        inside = inside && !share_face(polygon.edges[root], polygon.edges[(root + k) % n]);
      }
      if (!inside) continue;
      std::rotate(polygon.edges.begin(), polygon.edges.begin() + static_cast<long>(root),
                  polygon.edges.end());
      return;
    }
    polygon.hub = true;
  }

  std::array<CubeEdge, 12> edges_;
  std::array<std::vector<Polygon>, 256> cases_;
};

/// Visits the cubes of the padded grid and collects vertices and faces.
class Marcher {
 public:
  explicit Marcher(const at::Tensor& values)
      : size_(values.size(0)), values_(values.const_data_ptr<float>()) {}

  scene::TriMesh run() {
    // One layer of cubes beyond the grid closes surfaces that touch its border.
    for (int64_t z = -1; z < size_; ++z) {
      for (int64_t y = -1; y < size_; ++y) {
        for (int64_t x = -1; x < size_; ++x) visit(x, y, z);
      }
    }
    const auto v = static_cast<int64_t>(vertices_.size() / 3);
    const auto f = static_cast<int64_t>(faces_.size() / 3);
    return {at::from_blob(vertices_.data(), {v, 3}, at::kFloat).clone(),
            at::from_blob(faces_.data(), {f, 3}, at::kInt).clone()};
  }

 private:
  [[nodiscard]] float value(int64_t x, int64_t y, int64_t z) const {
    const auto out = [&](int64_t c) { return c < 0 || c >= size_; };
    if (out(x) || out(y) || out(z)) return -1.0F;
    return values_[(z * size_ + y) * size_ + x];
  }

  void visit(int64_t x, int64_t y, int64_t z) {
    float corner[8];
    int mask = 0;
    for (int c = 0; c < 8; ++c) {
      corner[c] = value(x + (c & 1), y + ((c >> 1) & 1), z + ((c >> 2) & 1));
      mask |= (corner[c] > 0 ? 1 : 0) << c;
    }
    if (mask == 0 || mask == 255) return;
    for (const Polygon& polygon : table_.polygons(mask)) {
      std::vector<int32_t> ring;
      for (const int e : polygon.edges) ring.push_back(vertex_on(e, x, y, z, corner));
      emit(polygon, ring);
    }
  }

  void emit(const Polygon& polygon, const std::vector<int32_t>& ring) {
    const size_t n = ring.size();
    if (!polygon.hub) {
      for (size_t k = 1; k + 1 < n; ++k) add_face(ring[0], ring[k], ring[k + 1]);
      return;
    }
    float middle[3] = {};
    for (const int32_t v : ring) {
      for (int k = 0; k < 3; ++k) middle[k] += vertices_[3 * v + k] / static_cast<float>(n);
    }
    const int32_t hub = add_vertex(middle);
    for (size_t k = 0; k < n; ++k) add_face(hub, ring[k], ring[(k + 1) % n]);
  }

  void add_face(int32_t a, int32_t b, int32_t c) { faces_.insert(faces_.end(), {a, b, c}); }

  int32_t add_vertex(const float p[3]) {
    vertices_.insert(vertices_.end(), p, p + 3);
    return static_cast<int32_t>(vertices_.size() / 3 - 1);
  }

  /// The vertex on a cube's edge, shared by the four cubes around it.
  int32_t vertex_on(int e, int64_t x, int64_t y, int64_t z, const float corner[8]) {
    const CubeEdge& edge = table_.edge(e);
    const int64_t base[3] = {x + (edge.a & 1), y + ((edge.a >> 1) & 1), z + ((edge.a >> 2) & 1)};
    const int64_t side = size_ + 2;
    const int64_t key = (((base[2] + 1) * side + base[1] + 1) * side + base[0] + 1) * 3 + edge.axis;
    const auto [found, fresh] = index_.try_emplace(key, 0);
    if (!fresh) return found->second;
    // Away from the corners, so that no triangle has zero area.
    constexpr float kMargin = 0.02F;
    const float share = corner[edge.a] / (corner[edge.a] - corner[edge.b]);
    const float t = std::clamp(share, kMargin, 1 - kMargin);
    float p[3];
    for (int k = 0; k < 3; ++k) {
      const float along = static_cast<float>(base[k]) + (k == edge.axis ? t : 0.0F);
      p[k] = 2 * along / static_cast<float>(size_ - 1) - 1;
    }
    return found->second = add_vertex(p);
  }

  int64_t size_;
  const float* values_;
  CaseTable table_;
  std::unordered_map<int64_t, int32_t> index_;
  std::vector<float> vertices_;
  std::vector<int32_t> faces_;
};

}  // namespace

scene::TriMesh marching_cubes(const at::Tensor& values) {
  TORCH_CHECK(values.dim() == 3 && values.size(0) == values.size(1) &&
                  values.size(1) == values.size(2) && values.size(0) >= 2,
              "values must be [G,G,G]");
  const at::Tensor dense = values.to(at::kFloat).contiguous();
  return Marcher(dense).run();
}

namespace {

/// Dilation of a flag grid [G,G,G] (bool) by `radius` cells along each axis.
at::Tensor dilated(const at::Tensor& flags, int64_t radius) {
  if (radius == 0) return flags;
  const int64_t width = 2 * radius + 1;
  return at::max_pool3d(flags.to(at::kFloat).unsqueeze(0), {width, width, width}, {1, 1, 1},
                        {radius, radius, radius})
             .squeeze(0) > 0;
}

/// Flood fill from the grid's border through the points where `open` [G,G,G] (bool) is set.
at::Tensor flooded_from_border(const at::Tensor& open) {
  const int64_t size = open.size(0);
  const at::Tensor dense = open.contiguous();
  const bool* free = dense.const_data_ptr<bool>();
  at::Tensor reached = at::zeros_like(dense);
  bool* r = reached.mutable_data_ptr<bool>();
  std::vector<int64_t> stack;
  const auto push = [&](int64_t i) {
    if (r[i] || !free[i]) return;
    r[i] = true;
    stack.push_back(i);
  };
  for (int64_t a = 0; a < size; ++a) {
    for (int64_t b = 0; b < size; ++b) {
      for (const int64_t c : {int64_t{0}, size - 1}) {
        push((a * size + b) * size + c);
        push((a * size + c) * size + b);
        push((c * size + a) * size + b);
      }
    }
  }
  while (!stack.empty()) {
    const int64_t i = stack.back();
    stack.pop_back();
    const int64_t x = i % size, y = i / size % size, z = i / size / size;
    if (x > 0) push(i - 1);
    if (x + 1 < size) push(i + 1);
    if (y > 0) push(i - size);
    if (y + 1 < size) push(i + size);
    if (z > 0) push(i - size * size);
    if (z + 1 < size) push(i + size * size);
  }
  return reached;
}

}  // namespace

void fill_cavities(const at::Tensor& values, int64_t radius) {
  const at::Tensor solid = values > 0;
  // Cubes of this radius that fit outside and connect to the border, and the space that they cover.
  const at::Tensor outside =
      dilated(flooded_from_border(dilated(solid, radius).logical_not()), radius);
  values.masked_fill_(outside.logical_or(solid).logical_not(), 1.0F);
}

}  // namespace tt3d::mesh
