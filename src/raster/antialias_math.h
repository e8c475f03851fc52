#pragma once

#include "rasterize_math.h"

/// Bodies of antialias: a pixel with its neighbours to the right and below.
namespace tt3d::raster {

/// A silhouette edge between the centres of pixels A and B.
struct EdgeCrossing {
  int32_t v0, v1;   ///< the edge's vertices
  double position;  ///< of the crossing: 0 at A's centre, 1 at B's
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

/// The view of face i of all views. (The first view avoids the division, which costs as much as the
/// rest of the body.)
TT3D_HD int64_t view_of_face(int64_t i, const Sizes& s) { return i < s.faces ? 0 : i / s.faces; }

/// The determinant of a triangle's clip positions without z. It has the sign of the triangle's area
/// on the screen, even if vertices are behind the camera (Olano & Greer 1997).
template <typename Value>
TT3D_HD Value turn_of(const FlatVertex<Value> corner[3]) {
  const FlatVertex<Value>&a = corner[0], &b = corner[1], &c = corner[2];
  return a.x * (b.y * c.w - b.w * c.y) - a.y * (b.x * c.w - b.w * c.x) +
         a.w * (b.x * c.y - b.y * c.x);
}

/// Body: orientation of face i (of all views), 1 if its vertices go counter-clockwise.
template <typename T>
struct FacingFace {
  const T* clip;
  const int32_t* faces;
  uint8_t* facing;  ///< [N,F]
  Sizes s;
  TT3D_HD void operator()(int64_t i) const {
    const int64_t view = view_of_face(i, s);
    const int32_t* triangle = faces + 3 * (i - view * s.faces);
    const T* points = clip + view * s.vertices * 4;
    FlatVertex<double> corner[3];
    load_flat_triangle(points, triangle, corner);
    facing[i] = turn_of(corner) > 0;
  }
};

/// Body: the silhouette edges of face i (of all views), bit k for edge k. An edge is a silhouette
/// if both of its faces lie on the same side of it on the screen, or if it has no second face.
struct SilhouetteEdges {
  const int32_t* faces;
  const int32_t* twins;   ///< [F,3], from edge_twins
  const uint8_t* facing;  ///< [N,F], from FacingFace
  uint8_t* edges;         ///< [N,F]
  Sizes s;
  TT3D_HD void operator()(int64_t i) const {
    const int64_t first = view_of_face(i, s) * s.faces;
    const uint8_t* turned = facing + first;
    const int64_t side = 3 * (i - first);
    unsigned bits = 0;
    for (int k = 0; k < 3; ++k) {
      const int32_t twin = twins[side + k];
      if (twin < 0) {
        bits |= 1U << k;
        continue;
      }
      const uint32_t at = static_cast<uint32_t>(twin), other = at / 3;
      const uint32_t next = at == 3 * other + 2 ? at - 2 : at + 1;
      // Two faces with the same orientation traverse their common edge in opposite directions.
      const bool agree = faces[next] == faces[side + (k + 2) % 3];
      bits |= static_cast<unsigned>((turned[i - first] == turned[other]) ^ agree) << k;
    }
    edges[i] = static_cast<uint8_t>(bits);
  }
};

/// Inputs of antialias for one view.
template <typename T>
struct AntialiasView {
  const T* clip;              ///< [V,4]
  const int32_t* faces;       ///< [F,3]
  const uint8_t* silhouette;  ///< [F], from SilhouetteEdges
};

/// Finds a silhouette edge that passes between the pixel centres A = (ax,ay) and B = (bx,by). The
/// edge belongs to the nearer of the two pixels' triangles. The pair is horizontal or vertical.
template <typename T>
TT3D_HD bool find_crossing(const AntialiasView<T>& view, const T* rast_a, const T* rast_b,
                           double ax, double ay, double bx, double by, bool horizontal,
                           EdgeCrossing& crossing) {
  const auto face_a = static_cast<int64_t>(rast_a[3]) - 1;
  const auto face_b = static_cast<int64_t>(rast_b[3]) - 1;
  if (face_a == face_b) return false;
  crossing.near_is_a = face_b < 0 || (face_a >= 0 && rast_a[2] < rast_b[2]);
  const int64_t face = crossing.near_is_a ? face_a : face_b;
  const unsigned silhouette = view.silhouette[face];
  if (silhouette == 0) return false;  // nearly always
  const int32_t* triangle = view.faces + face * 3;
  for (int k = 0; k < 3; ++k) {
    if ((silhouette >> k & 1U) == 0) continue;
    const int32_t v0 = triangle[(k + 1) % 3], v1 = triangle[(k + 2) % 3];
    const ClipVertex p0 = load_vertex(view.clip, v0), p1 = load_vertex(view.clip, v1);
    if (!(p0.w > 0) || !(p1.w > 0)) continue;
    const Relative a0 = {p0.x - ax * p0.w, p0.y - ay * p0.w};
    const Relative a1 = {p1.x - ax * p1.w, p1.y - ay * p1.w};
    // The edge must span the line through both pixels.
    const bool spans = horizontal ? (a0.y > 0) != (a1.y > 0) : (a0.x > 0) != (a1.x > 0);
    if (!spans) continue;
    const double e_a = cross(a0, a1);
    const double e_b =
        cross({p0.x - bx * p0.w, p0.y - by * p0.w}, {p1.x - bx * p1.w, p1.y - by * p1.w});
    if ((e_a > 0) == (e_b > 0) || e_a == e_b) continue;
    crossing.v0 = v0;
    crossing.v1 = v1;
    crossing.position = e_a / (e_a - e_b);
    return true;
  }
  return false;
}

/// Blending at a crossing: the pixel cut by the edge receives a fraction of the other pixel's
/// colour. The weight is the distance from the crossing to the midpoint of A..B.
struct Blend {
  bool into_a;    ///< A receives B's colour (else B receives A's)
  double weight;  ///< in [0, 0.5]
  double slope;   ///< d weight / d position
};

TT3D_HD Blend blend_of(const EdgeCrossing& crossing) {
  // The near surface reaches from its own pixel to the crossing. Beyond the midpoint it covers a
  // part of the other pixel; short of it, the other surface covers a part of the near pixel.
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

/// Inputs of antialias for all views.
template <typename T>
struct AntialiasScene {
  const T* rast;
  const T* clip;
  const int32_t* faces;
  const uint8_t* silhouette;  ///< [N,F]
  [[nodiscard]] TT3D_HD AntialiasView<T> view(int64_t n, const Sizes& s) const {
    return {clip + n * s.vertices * 4, faces, silhouette + n * s.faces};
  }
};

/// Two neighbouring pixels that a silhouette edge separates.
struct CrossedPair {
  int64_t a, b;           ///< pixels of all views
  double ax, ay, bx, by;  ///< their centres
  EdgeCrossing crossing;
};

/// The pair of a pixel and its neighbour to the right or below; false if there is no such neighbour
/// or no silhouette between them.
template <typename T>
TT3D_HD bool crossed_pair(const AntialiasScene<T>& scene, const Sizes& s, const PixelPlace& at,
                          bool horizontal, CrossedPair& pair) {
  if (horizontal ? at.column + 1 >= s.width : at.row + 1 >= s.height) return false;
  pair.a = (at.view * s.height + at.row) * s.width + at.column;
  pair.b = horizontal ? pair.a + 1 : pair.a + s.width;
  if (scene.rast[4 * pair.a + 3] == scene.rast[4 * pair.b + 3]) return false;
  pair.ax = pixel_x(at.column, s.width);
  pair.ay = pixel_y(at.row, s.height);
  pair.bx = horizontal ? pixel_x(at.column + 1, s.width) : pair.ax;
  pair.by = horizontal ? pair.ay : pixel_y(at.row + 1, s.height);
  return find_crossing(scene.view(at.view, s), scene.rast + 4 * pair.a, scene.rast + 4 * pair.b,
                       pair.ax, pair.ay, pair.bx, pair.by, horizontal, pair.crossing);
}

template <typename T>
struct AntialiasPixel {
  AntialiasScene<T> scene;
  const T* color;
  T* out;
  Sizes s;
  TT3D_HD void operator()(const PixelPlace& at) const {
    CrossedPair pair;
    if (crossed_pair(scene, s, at, true, pair)) blend(pair);
    if (crossed_pair(scene, s, at, false, pair)) blend(pair);
  }
  TT3D_HD void operator()(int64_t i) const { (*this)(place_of(i, s)); }

  TT3D_HD void blend(const CrossedPair& pair) const {
    const int64_t channels = s.channels;
    const Blend by = blend_of(pair.crossing);
    const int64_t into = (by.into_a ? pair.a : pair.b) * channels;
    const int64_t from = (by.into_a ? pair.b : pair.a) * channels;
    for (int64_t c = 0; c < channels; ++c) {
      accumulate(out + into + c, static_cast<T>(by.weight) * (color[from + c] - color[into + c]));
    }
  }
};

template <typename T>
struct AntialiasBackwardPixel {
  AntialiasScene<T> scene;
  const T* color;
  const T* grad_out;
  T* grad_color;
  T* grad_clip;  ///< may be null
  Sizes s;
  TT3D_HD void operator()(const PixelPlace& at) const {
    CrossedPair pair;
    if (crossed_pair(scene, s, at, true, pair)) spread(pair, at.view);
    if (crossed_pair(scene, s, at, false, pair)) spread(pair, at.view);
  }
  TT3D_HD void operator()(int64_t i) const { (*this)(place_of(i, s)); }

  TT3D_HD void spread(const CrossedPair& pair, int64_t view) const {
    const int64_t channels = s.channels;
    const Blend by = blend_of(pair.crossing);
    const int64_t into = (by.into_a ? pair.a : pair.b) * channels;
    const int64_t from = (by.into_a ? pair.b : pair.a) * channels;
    double grad_weight = 0;
    for (int64_t c = 0; c < channels; ++c) {
      const T g = grad_out[into + c];
      accumulate(grad_color + from + c, static_cast<T>(by.weight) * g);
      accumulate(grad_color + into + c, -(static_cast<T>(by.weight) * g));
      grad_weight += static_cast<double>(g * (color[from + c] - color[into + c]));
    }
    if (!grad_clip) return;
    const int64_t first = view * s.vertices;
    double grad0[4] = {}, grad1[4] = {};
    crossing_backward(scene.clip + first * 4, pair.crossing, pair.ax, pair.ay, pair.bx, pair.by,
                      grad_weight * by.slope, grad0, grad1);
    for (int k = 0; k < 4; ++k) {
      accumulate(grad_clip + (first + pair.crossing.v0) * 4 + k, static_cast<T>(grad0[k]));
      accumulate(grad_clip + (first + pair.crossing.v1) * 4 + k, static_cast<T>(grad1[k]));
    }
  }
};

}  // namespace tt3d::raster
