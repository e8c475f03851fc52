#pragma once

#include "rasterize_math.h"

/// Body of antialias: one pair of neighbouring pixels.
namespace tt3d::raster {

/// A silhouette edge between the centres of pixels A and B.
struct EdgeCrossing {
  int32_t v0, v1;   ///< the edge's vertices
  double position;  ///< where it crosses, 0 at A's centre, 1 at B's
  bool near_is_a;   ///< the edge's triangle is the one seen at A
};

/// A position relative to a pixel: p' = p.xy - P p.w.
struct Relative {
  double x, y;
};

template <typename T>
TT3D_HD Relative relative_to(const T* clip, int32_t vertex, double px, double py) {
  const ClipVertex v = load_vertex(clip, vertex);
  return {v.x - px * v.w, v.y - py * v.w};
}

TT3D_HD double cross(const Relative& p, const Relative& q) { return p.x * q.y - p.y * q.x; }

/// Whether the faces on both sides of edge (v0,v1) lie on the same side of it on the screen, seen
/// from pixel P; an edge without a second face is always a silhouette.
template <typename T>
TT3D_HD bool is_silhouette(const T* clip, int32_t v0, int32_t v1, int32_t own, int32_t opposite,
                           double px, double py) {
  if (opposite < 0) return true;
  const Relative a = relative_to(clip, v0, px, py);
  const Relative b = relative_to(clip, v1, px, py);
  const Relative p = relative_to(clip, own, px, py);
  const Relative q = relative_to(clip, opposite, px, py);
  // Signed area of the homogeneous triangle: sum of its three edge functions.
  const double own_area = cross(a, b) + cross(b, p) + cross(p, a);
  const double other_area = cross(a, b) + cross(b, q) + cross(q, a);
  return (own_area > 0) == (other_area > 0);
}

/// Finds the silhouette edge of the nearer of two pixels' triangles that passes between the pixel
/// centres A = (ax,ay) and B = (bx,by). The pair is horizontal or vertical.
template <typename T>
TT3D_HD bool find_crossing(const T* clip, const int32_t* faces, const int32_t* opposites,
                           const T* rast_a, const T* rast_b, double ax, double ay, double bx,
                           double by, bool horizontal, EdgeCrossing& crossing) {
  const auto face_a = static_cast<int64_t>(rast_a[3]) - 1;
  const auto face_b = static_cast<int64_t>(rast_b[3]) - 1;
  if (face_a == face_b) return false;
  crossing.near_is_a = face_b < 0 || (face_a >= 0 && rast_a[2] < rast_b[2]);
  const int64_t face = crossing.near_is_a ? face_a : face_b;
  const int32_t* triangle = faces + face * 3;
  for (int k = 0; k < 3; ++k) {
    const int32_t v0 = triangle[(k + 1) % 3], v1 = triangle[(k + 2) % 3];
    const ClipVertex p0 = load_vertex(clip, v0), p1 = load_vertex(clip, v1);
    if (!(p0.w > 0) || !(p1.w > 0)) continue;
    const Relative a0 = {p0.x - ax * p0.w, p0.y - ay * p0.w};
    const Relative a1 = {p1.x - ax * p1.w, p1.y - ay * p1.w};
    // The edge must span the pixels' common line.
    const bool spans = horizontal ? (a0.y > 0) != (a1.y > 0) : (a0.x > 0) != (a1.x > 0);
    if (!spans) continue;
    const double e_a = cross(a0, a1);
    const double e_b =
        cross({p0.x - bx * p0.w, p0.y - by * p0.w}, {p1.x - bx * p1.w, p1.y - by * p1.w});
    if ((e_a > 0) == (e_b > 0) || e_a == e_b) continue;
    if (!is_silhouette(clip, v0, v1, triangle[k], opposites[face * 3 + k], ax, ay)) continue;
    crossing.v0 = v0;
    crossing.v1 = v1;
    crossing.position = e_a / (e_a - e_b);
    return true;
  }
  return false;
}

/// How far a crossing blends: the pixel that the edge cuts receives this share of the other one.
/// Covered length of A..B by the near side, beyond (or short of) the midpoint between them.
struct Blend {
  bool into_a;    ///< A receives B's colour (else B receives A's)
  double weight;  ///< in [0, 0.5]
  double slope;   ///< d weight / d position
};

TT3D_HD Blend blend_of(const EdgeCrossing& crossing) {
  // The near surface reaches from its own pixel up to the crossing. Past the midpoint it spills
  // into the other pixel; short of it, the other pixel's surface spills into the near one.
  const double position = crossing.position;
  if (position >= 0.5) return {false, position - 0.5, 1.0};
  return {true, 0.5 - position, -1.0};
}

/// Gradient of the crossing's position with respect to the edge's two vertices:
/// position = e_A / (e_A - e_B). Adds grad * d position to grad0[4], grad1[4].
template <typename T>
TT3D_HD void crossing_backward(const T* clip, const EdgeCrossing& crossing, double ax, double ay,
                               double bx, double by, double grad, double grad0[4],
                               double grad1[4]) {
  const Relative a0 = relative_to(clip, crossing.v0, ax, ay);
  const Relative a1 = relative_to(clip, crossing.v1, ax, ay);
  const Relative b0 = relative_to(clip, crossing.v0, bx, by);
  const Relative b1 = relative_to(clip, crossing.v1, bx, by);
  const double e_a = cross(a0, a1), e_b = cross(b0, b1);
  const double inverse = 1.0 / ((e_a - e_b) * (e_a - e_b));
  const double grad_a = -grad * e_b * inverse;
  const double grad_b = grad * e_a * inverse;
  const double x0 = grad_a * a1.y + grad_b * b1.y, y0 = -grad_a * a1.x - grad_b * b1.x;
  const double x1 = -grad_a * a0.y - grad_b * b0.y, y1 = grad_a * a0.x + grad_b * b0.x;
  grad0[0] += x0;
  grad0[1] += y0;
  grad0[3] -= grad_a * (ax * a1.y - ay * a1.x) + grad_b * (bx * b1.y - by * b1.x);
  grad1[0] += x1;
  grad1[1] += y1;
  grad1[3] -= grad_a * (-ax * a0.y + ay * a0.x) + grad_b * (-bx * b0.y + by * b0.x);
}

}  // namespace tt3d::raster
