#include <ATen/ATen.h>
#include <meshoptimizer.h>

#include <algorithm>
#include <cmath>
#include <unordered_map>

#include "topology.h"
#include "tt3d/mesh.h"
#include "tt3d/surface.h"

namespace tt3d::mesh {
namespace {

std::vector<Face> simplified_faces(const std::vector<Point>& points, const std::vector<Face>& faces,
                                   size_t target_faces, unsigned int options) {
  std::vector<unsigned int> indices;
  for (const Face& f : faces) {
    for (const int32_t v : f) indices.push_back(static_cast<unsigned int>(v));
  }
  std::vector<unsigned int> out(indices.size());
  constexpr float kAnyError = 1.0F;  // only the count limits the simplification
  const size_t count =
      meshopt_simplify(out.data(), indices.data(), indices.size(), points[0].data(), points.size(),
                       sizeof(Point), target_faces * 3, kAnyError, options, nullptr);
  std::vector<Face> result;
  for (size_t i = 0; i < count; i += 3) {
    result.push_back({static_cast<int32_t>(out[i]), static_cast<int32_t>(out[i + 1]),
                      static_cast<int32_t>(out[i + 2])});
  }
  return result;
}

/// The selected faces, and the others.
std::pair<std::vector<Face>, std::vector<Face>> partition(const std::vector<Face>& faces,
                                                          const at::Tensor& selected) {
  const at::Tensor dense = selected.cpu().to(at::kBool).contiguous();
  const bool* chosen = dense.const_data_ptr<bool>();
  std::pair<std::vector<Face>, std::vector<Face>> parts;
  for (size_t i = 0; i < faces.size(); ++i) {
    (chosen[i] ? parts.first : parts.second).push_back(faces[i]);
  }
  return parts;
}

}  // namespace

scene::TriMesh simplify(const scene::TriMesh& m, int64_t target_faces) {
  const auto points = points_of(m);
  const auto faces = faces_of(m);
  if (static_cast<int64_t>(faces.size()) <= target_faces) return m;
  return close_holes(repair(
      make_mesh(points, simplified_faces(points, faces, static_cast<size_t>(target_faces), 0))));
}

scene::TriMesh decimate(const scene::TriMesh& m, const at::Tensor& selected, double ratio) {
  const auto points = points_of(m);
  auto [chosen, kept] = partition(faces_of(m), selected);
  if (chosen.empty()) return m;
  const auto target = static_cast<size_t>(static_cast<double>(chosen.size()) * ratio);
  const auto thinned = simplified_faces(points, chosen, target, meshopt_SimplifyLockBorder);
  kept.insert(kept.end(), thinned.begin(), thinned.end());
  return close_holes(repair(make_mesh(points, kept)));
}

namespace {

/// A vertex in the middle of each edge that is split, by edge_key.
using Midpoints = std::unordered_map<uint64_t, int32_t>;

/// Adds midpoints of the selected faces' edges of at least 2 * min_edge to `points`.
Midpoints add_midpoints(const std::vector<Face>& selected, double min_edge,
                        std::vector<Point>& points) {
  Midpoints middle;
  for (const Face& f : selected) {
    for (int k = 0; k < 3; ++k) {
      const int32_t a = f[k], b = f[(k + 1) % 3];
      const float length = std::hypot(points[a][0] - points[b][0], points[a][1] - points[b][1],
                                      points[a][2] - points[b][2]);
      if (static_cast<double>(length) < 2 * min_edge) continue;
      const auto [found, fresh] =
          middle.try_emplace(edge_key(a, b), static_cast<int32_t>(points.size()));
      if (!fresh) continue;
      Point p;
      for (int i = 0; i < 3; ++i) p[i] = 0.5F * (points[a][i] + points[b][i]);
      points.push_back(p);
    }
  }
  return middle;
}

/// Appends the one to four faces that a face becomes, by which of its edges are split.
void split_face(const Face& f, const Midpoints& middle, std::vector<Face>& out) {
  int32_t mid[3];
  int count = 0;
  for (int k = 0; k < 3; ++k) {
    const auto found = middle.find(edge_key(f[k], f[(k + 1) % 3]));
    mid[k] = found == middle.end() ? -1 : found->second;
    count += mid[k] >= 0;
  }
  if (count == 0) {
    out.push_back(f);
  } else if (count == 3) {
    out.insert(out.end(), {{f[0], mid[0], mid[2]},
                           {f[1], mid[1], mid[0]},
                           {f[2], mid[2], mid[1]},
                           {mid[0], mid[1], mid[2]}});
  } else if (count == 1) {
    const int k = mid[0] >= 0 ? 0 : (mid[1] >= 0 ? 1 : 2);
    const int32_t a = f[k], b = f[(k + 1) % 3], c = f[(k + 2) % 3];
    out.insert(out.end(), {{a, mid[k], c}, {mid[k], b, c}});
  } else {
    // Rotate so that the edge without a midpoint is a -> b.
    const int k = mid[0] < 0 ? 0 : (mid[1] < 0 ? 1 : 2);
    const int32_t a = f[k], b = f[(k + 1) % 3], c = f[(k + 2) % 3];
    const int32_t bc = mid[(k + 1) % 3], ca = mid[(k + 2) % 3];
    out.insert(out.end(), {{a, b, bc}, {a, bc, ca}, {ca, bc, c}});
  }
}

}  // namespace

scene::TriMesh subdivide(const scene::TriMesh& m, const at::Tensor& selected, double min_edge) {
  auto points = points_of(m);
  const auto faces = faces_of(m);
  const Midpoints middle = add_midpoints(partition(faces, selected).first, min_edge, points);
  std::vector<Face> out;
  for (const Face& f : faces) split_face(f, middle, out);
  return make_mesh(points, out);
}

}  // namespace tt3d::mesh
