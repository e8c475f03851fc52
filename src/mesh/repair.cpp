#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <unordered_map>

#include "topology.h"
#include "tt3d/mesh.h"
#include "tt3d/surface.h"

namespace tt3d::mesh {
namespace {

/// Side k of a face: the directed edge from its vertex k to the next.
struct Side {
  int32_t face;
  int k;
};

using EdgeSides = std::unordered_map<uint64_t, std::vector<Side>>;

EdgeSides sides_by_edge(const std::vector<Face>& faces) {
  EdgeSides sides;
  sides.reserve(faces.size() * 3 / 2);
  for (size_t f = 0; f < faces.size(); ++f) {
    for (int k = 0; k < 3; ++k) {
      sides[mesh::edge_key(faces[f][k], faces[f][(k + 1) % 3])].push_back(
          {static_cast<int32_t>(f), k});
    }
  }
  return sides;
}

/// Removes duplicates: of faces with the same three vertices, opposite orientations cancel, and one
/// of several with the same orientation stays. Removes degenerate faces.
std::vector<Face> without_doubles(const std::vector<Face>& faces) {
  struct Count {
    int even = 0, odd = 0;
  };
  std::map<Face, Count> counts;
  const auto key_of = [](const Face& f, bool& odd) {
    Face sorted = f;
    odd = false;
    for (int pass = 0; pass < 2; ++pass) {
      for (int k = 0; k < 2; ++k) {
        if (sorted[k] > sorted[k + 1]) {
          std::swap(sorted[k], sorted[k + 1]);
          odd = !odd;
        }
      }
    }
    return sorted;
  };
  for (const Face& f : faces) {
    bool odd = false;
    Count& count = counts[key_of(f, odd)];
    ++(odd ? count.odd : count.even);
  }
  std::vector<Face> kept;
  for (const Face& f : faces) {
    if (f[0] == f[1] || f[1] == f[2] || f[2] == f[0]) continue;
    bool odd = false;
    Count& count = counts[key_of(f, odd)];
    int& own = odd ? count.odd : count.even;
    if (own == 0 || (count.even > 0 && count.odd > 0)) continue;
    own = 0;
    kept.push_back(f);
  }
  return kept;
}

/// Angle of a face around the directed edge a -> b, relative to an arbitrary fixed direction.
double angle_around(const Point& a, const Point& b, const Point& p) {
  double axis[3], up[3], to[3], norm = 0;
  for (int k = 0; k < 3; ++k) axis[k] = double(b[k]) - a[k];
  for (const double x : axis) norm += x * x;
  norm = std::sqrt(norm) + 1e-30;
  for (double& x : axis) x /= norm;
  int least = 0;
  for (int k = 1; k < 3; ++k) {
    if (std::abs(axis[k]) < std::abs(axis[least])) least = k;
  }
  for (int k = 0; k < 3; ++k) {
    up[k] = (k == least ? 1.0 : 0.0) - axis[least] * axis[k];
    to[k] = double(p[k]) - a[k];
  }
  const double right[3] = {axis[1] * up[2] - axis[2] * up[1], axis[2] * up[0] - axis[0] * up[2],
                           axis[0] * up[1] - axis[1] * up[0]};
  const double x = to[0] * up[0] + to[1] * up[1] + to[2] * up[2];
  const double y = to[0] * right[0] + to[1] * right[1] + to[2] * right[2];
  return std::atan2(y, x);
}

/// Pairs the sides at an edge with more than two faces. In order around the edge, a face with
/// direction a -> b and the next one with direction b -> a enclose solid space; these two stay
/// connected.
std::vector<std::pair<Side, Side>> pair_sides(const std::vector<Side>& sides,
                                              const std::vector<Face>& faces,
                                              const std::vector<Point>& points) {
  const Face& first = faces[sides[0].face];
  const int32_t a = std::min(first[sides[0].k], first[(sides[0].k + 1) % 3]);
  const int32_t b = std::max(first[sides[0].k], first[(sides[0].k + 1) % 3]);
  struct Around {
    double angle;
    bool forward;
    Side side;
  };
  std::vector<Around> order;
  for (const Side& s : sides) {
    const Face& f = faces[s.face];
    order.push_back({angle_around(points[a], points[b], points[f[(s.k + 2) % 3]]), f[s.k] == a, s});
  }
  std::sort(order.begin(), order.end(),
            [](const Around& x, const Around& y) { return x.angle < y.angle; });
  std::vector<std::pair<Side, Side>> pairs;
  std::vector<uint8_t> taken(order.size(), 0);
  // Repeatedly pair neighbours of opposite direction with the inside between them.
  for (size_t round = 0; round < order.size(); ++round) {
    for (size_t i = 0; i < order.size(); ++i) {
      if (taken[i] || !order[i].forward) continue;
      size_t j = (i + 1) % order.size();
      while (taken[j]) j = (j + 1) % order.size();
      if (j == i || order[j].forward) continue;
      taken[i] = taken[j] = 1;
      pairs.emplace_back(order[i].side, order[j].side);
    }
  }
  return pairs;
}

/// Gives every fan of faces around a vertex its own copy of the vertex. Faces belong to one fan if
/// paired sides connect them. This separates the faces at an edge with more than two of them,
/// unless both ends stay connected elsewhere.
bool split_fans(std::vector<Point>& points, std::vector<Face>& faces) {
  const EdgeSides sides = sides_by_edge(faces);
  UnionFind corners(faces.size() * 3);
  const auto join = [&](const Side& s, const Side& t) {
    // Side s runs f[k] -> f[k+1]; its partner runs the opposite way.
    corners.join(s.face * 3 + s.k, t.face * 3 + (t.k + 1) % 3);
    corners.join(s.face * 3 + (s.k + 1) % 3, t.face * 3 + t.k);
  };
  for (const auto& [key, list] : sides) {
    if (list.size() == 2)
      join(list[0], list[1]);
    else if (list.size() > 2) {
      for (const auto& [s, t] : pair_sides(list, faces, points)) join(s, t);
    }
  }
  std::vector<int32_t> owner(points.size(), -1);
  std::unordered_map<int32_t, int32_t> copy_of;
  bool changed = false;
  for (size_t f = 0; f < faces.size(); ++f) {
    for (int k = 0; k < 3; ++k) {
      const int32_t root = corners.find(static_cast<int32_t>(3 * f) + k);
      int32_t& v = faces[f][k];
      if (owner[v] < 0) owner[v] = root;
      if (owner[v] == root) continue;
      const auto [found, fresh] = copy_of.try_emplace(root, static_cast<int32_t>(points.size()));
      if (fresh) {
        points.push_back(points[v]);
        owner.push_back(root);
      }
      v = found->second;
      changed = true;
    }
  }
  return changed;
}

/// Handles edges that split_fans could not separate: each pair of sides but one gets a vertex in
/// the middle of the edge.
bool split_edges(std::vector<Point>& points, std::vector<Face>& faces) {
  std::vector<std::pair<Side, Side>> to_split;
  std::vector<uint8_t> touched(faces.size(), 0);
  for (const auto& [key, list] : sides_by_edge(faces)) {
    if (list.size() <= 2) continue;
    const auto pairs = pair_sides(list, faces, points);
    for (size_t i = 1; i < pairs.size(); ++i) {
      const auto& [s, t] = pairs[i];
      if (touched[s.face] || touched[t.face]) continue;
      touched[s.face] = touched[t.face] = 1;
      to_split.push_back(pairs[i]);
    }
  }
  for (const auto& [s, t] : to_split) {
    const int32_t a = faces[s.face][s.k], b = faces[s.face][(s.k + 1) % 3];
    Point middle;
    for (int k = 0; k < 3; ++k) middle[k] = 0.5F * (points[a][k] + points[b][k]);
    const auto m = static_cast<int32_t>(points.size());
    points.push_back(middle);
    for (const Side& side : {s, t}) {
      const Face f = faces[side.face];
      const int32_t from = f[side.k], to = f[(side.k + 1) % 3], apex = f[(side.k + 2) % 3];
      faces[side.face] = {from, m, apex};
      faces.push_back({m, to, apex});
    }
  }
  return !to_split.empty();
}

}  // namespace

scene::TriMesh repair(const scene::TriMesh& m) {
  auto points = mesh::points_of(m);
  auto faces = without_doubles(mesh::faces_of(m));
  constexpr int kMaxRounds = 8;
  for (int round = 0; round < kMaxRounds; ++round) {
    split_fans(points, faces);
    if (!split_edges(points, faces)) break;
  }
  return mesh::compact(points, faces);
}

scene::TriMesh close_holes(const scene::TriMesh& m) {
  auto points = mesh::points_of(m);
  auto faces = mesh::faces_of(m);
  // A hole's boundary has the opposite direction of the free sides; `next` maps each of its
  // vertices to the following one.
  std::map<int32_t, int32_t> next;
  for (const auto& [key, list] : sides_by_edge(faces)) {
    if (list.size() != 1) continue;
    const Face& f = faces[list[0].face];
    next[f[(list[0].k + 1) % 3]] = f[list[0].k];
  }
  while (!next.empty()) {
    std::vector<int32_t> rim;
    for (int32_t v = next.begin()->first; next.contains(v);) {
      rim.push_back(v);
      const int32_t following = next[v];
      next.erase(v);
      v = following;
    }
    if (rim.size() < 3) continue;
    if (rim.size() == 3) {
      faces.push_back({rim[0], rim[1], rim[2]});
      continue;
    }
    Point middle = {0, 0, 0};
    for (const int32_t v : rim) {
      for (int k = 0; k < 3; ++k) middle[k] += points[v][k] / static_cast<float>(rim.size());
    }
    const auto hub = static_cast<int32_t>(points.size());
    points.push_back(middle);
    for (size_t k = 0; k < rim.size(); ++k) {
      faces.push_back({hub, rim[k], rim[(k + 1) % rim.size()]});
    }
  }
  return repair(mesh::make_mesh(points, faces));
}

}  // namespace tt3d::mesh
