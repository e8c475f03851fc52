#pragma once

#include <cmath>
#include <cstdint>
#include <type_traits>

#include "tt3d/kernel.h"

/// Bodies of rasterize: one triangle, one pixel. No tensor library here.
namespace tt3d::raster {

/// Sizes that the operators share.
struct Sizes {
  int64_t views, vertices, faces, height, width, channels;
  [[nodiscard]] TT3D_HD int64_t pixels() const { return views * height * width; }
};

/// View, row and column of pixel i of all views.
struct PixelPlace {
  int64_t view, row, column;
};

TT3D_HD PixelPlace place_of(int64_t i, const Sizes& s) {
  const int64_t line = i / s.width;
  return {line / s.height, line % s.height, i % s.width};
}

/// A vertex in clip space, in double precision.
struct ClipVertex {
  double x, y, z, w;
};

template <typename T>
TT3D_HD ClipVertex load_vertex(const T* clip, int64_t vertex) {
  const T* p = clip + vertex * 4;
  return {static_cast<double>(p[0]), static_cast<double>(p[1]), static_cast<double>(p[2]),
          static_cast<double>(p[3])};
}

/// A triangle's vertices in clip space.
struct ClipTriangle {
  ClipVertex corner[3];
};

template <typename T>
TT3D_HD ClipTriangle load_triangle(const T* clip, const int32_t* face) {
  return {{load_vertex(clip, face[0]), load_vertex(clip, face[1]), load_vertex(clip, face[2])}};
}

/// A linear function a px + b py + c of the screen position. The function of a directed edge
/// through two clip vertices is positive to its left. Doubles, because the terms cancel almost
/// completely on small triangles.
struct ScreenFunction {
  double a, b, c;
  /// The function split into a column term and a row term, so that each is computed once per column
  /// or row; the value is their sum.
  template <typename Value>
  [[nodiscard]] TT3D_HD Value of_column(const Value& px) const {
    return a * px;
  }
  template <typename Value>
  [[nodiscard]] TT3D_HD Value of_row(const Value& py) const {
    return b * py + c;
  }
  [[nodiscard]] TT3D_HD double at(double px, double py) const { return of_column(px) + of_row(py); }
  /// Sign at (px,py), never 0 for a real edge. A pixel exactly on the edge counts as if moved by
  /// (eps, eps^2), so that every point, even at a vertex, belongs to exactly one side.
  TT3D_HD int sign_at(double value) const {
    if (value != 0) return value > 0 ? 1 : -1;
    if (a != 0) return a > 0 ? 1 : -1;
    return b > 0 ? 1 : (b < 0 ? -1 : 0);
  }
};

/// The edge from p to q: cross(p - P p.w, q - P q.w) expanded in the pixel P. If products are
/// rounded before they are subtracted (no fused multiply-adds), the edge from q to p is its exact
/// negative. Both triangles at an edge then compute the same bits up to the sign.
TT3D_HD ScreenFunction edge_function(const ClipVertex& p, const ClipVertex& q) {
  return {p.y * q.w - p.w * q.y, p.w * q.x - p.x * q.w, p.x * q.y - p.y * q.x};
}

/// The edges of a triangle, edge k opposite vertex k.
TT3D_HD void edges_of(const ClipTriangle& v, ScreenFunction edge[3]) {
  for (int k = 0; k < 3; ++k) edge[k] = edge_function(v.corner[(k + 1) % 3], v.corner[(k + 2) % 3]);
}

/// The data of a triangle for tests at pixels.
struct TriangleSetup {
  ScreenFunction edge[3];              ///< edge k is opposite vertex k; positive inside
  ScreenFunction depth;                ///< z/w, which is linear on the screen
  int x_begin, x_end, y_begin, y_end;  ///< pixel range that can be covered
};

/// Coordinate of pixel column c in normalised device coordinates. (Value: double, or on the CPU a
/// vector of doubles.)
template <typename Value>
TT3D_HD Value pixel_x(const Value& c, int64_t width) {
  static_assert(!std::is_integral_v<Value>, "an integer Value would truncate the result");
  const double inverse = 1.0 / static_cast<double>(width);  // once per loop, not once per pixel
  return (2.0 * c + 1.0) * inverse - 1.0;
}
TT3D_HD double pixel_x(int64_t c, int64_t width) { return pixel_x(static_cast<double>(c), width); }

/// Coordinate of pixel row r, row 0 at the top (y = +1).
TT3D_HD double pixel_y(int64_t r, int64_t height) {
  const double inverse = 1.0 / static_cast<double>(height);
  return 1.0 - (2.0 * static_cast<double>(r) + 1.0) * inverse;
}

/// The smallest pixel in [0,limit] that is not below `value`; NaN gives 0. (std::ceil is a function
/// call on processors without SSE4.1, the build's baseline.)
TT3D_HD int pixel_from(double value, int64_t limit) {
  if (!(value > 0)) return 0;
  if (value >= static_cast<double>(limit)) return static_cast<int>(limit);
  const int whole = static_cast<int>(value);
  return whole + (static_cast<double>(whole) < value ? 1 : 0);
}

/// One past the largest pixel in [0,limit) that is not above `value`; NaN gives 0.
TT3D_HD int pixel_past(double value, int64_t limit) {
  if (!(value >= 0)) return 0;
  return value >= static_cast<double>(limit) ? static_cast<int>(limit)
                                             : static_cast<int>(value) + 1;
}

/// Value: a number, or on the CPU a vector of numbers.
template <typename Value>
TT3D_HD Value least(const Value& a, const Value& b, const Value& c) {
  const Value ab = a < b ? a : b;
  return ab < c ? ab : c;
}

template <typename Value>
TT3D_HD Value greatest(const Value& a, const Value& b, const Value& c) {
  const Value ab = a > b ? a : b;
  return ab > c ? ab : c;
}

/// The pixel range [begin,past) of one vertex. A triangle's range goes from its vertices' least
/// begin to their greatest past. A vertex behind the camera has the whole picture as its range.
struct VertexBounds {
  int x_begin, y_begin, x_past, y_past;
  bool in_front;  ///< of the camera
  float depth;    ///< z/w of the vertex, to separate near from far; the result never depends on it
};

TT3D_HD VertexBounds vertex_bounds(const ClipVertex& v, int64_t height, int64_t width) {
  if (!(v.w > 0)) return {0, 0, static_cast<int>(width), static_cast<int>(height), false, 0};
  // The margin covers rounding; the edge functions decide.
  constexpr double kMargin = 1e-6;
  const double inverse = 1 / v.w;
  const double x = (v.x * inverse + 1) * (0.5 * static_cast<double>(width)) - 0.5;
  const double y = (1 - v.y * inverse) * (0.5 * static_cast<double>(height)) - 0.5;
  return {pixel_from(x - kMargin, width),
          pixel_from(y - kMargin, height),
          pixel_past(x + kMargin, width),
          pixel_past(y + kMargin, height),
          true,
          static_cast<float>(v.z * inverse)};
}

/// Sets the pixel range of a triangle; false when it is empty.
TT3D_HD bool set_bounds(const VertexBounds& p, const VertexBounds& q, const VertexBounds& r,
                        TriangleSetup& setup) {
  setup.x_begin = least(p.x_begin, q.x_begin, r.x_begin);
  setup.y_begin = least(p.y_begin, q.y_begin, r.y_begin);
  setup.x_end = greatest(p.x_past, q.x_past, r.x_past);
  setup.y_end = greatest(p.y_past, q.y_past, r.y_past);
  return setup.x_begin < setup.x_end && setup.y_begin < setup.y_end &&
         (p.in_front || q.in_front || r.in_front);
}

/// The edge functions of a triangle (positive inside) and its depth function. False if its area on
/// the screen is 0 or not finite. There are no branches, so that loops over triangles vectorise.
TT3D_HD bool screen_functions(const ClipTriangle& v, ScreenFunction e[3], ScreenFunction& depth) {
  edges_of(v, e);
  // In homogeneous coordinates sum_k e_k(P) (x_k,y_k,w_k) = determinant (P,1) at every position P
  // (Olano & Greer 1997). Hence sum_k e_k z_k / determinant is z/w. Multiplied by the determinant's
  // sign, all e_k are positive inside, where the surface is in front of the camera.
  const double determinant =
      e[0].c * v.corner[0].w + e[1].c * v.corner[1].w + e[2].c * v.corner[2].w;
  const double side = determinant > 0 ? 1.0 : -1.0;
  const double inverse = 1 / determinant;
  depth = {0, 0, 0};
  for (int k = 0; k < 3; ++k) {
    const double share = v.corner[k].z * inverse;
    depth.a += e[k].a * share;
    depth.b += e[k].b * share;
    depth.c += e[k].c * share;
    e[k] = {side * e[k].a, side * e[k].b, side * e[k].c};
  }
  return (determinant != 0) & (determinant - determinant == 0);
}

/// Computes the functions of a triangle whose bounds are set. False as in screen_functions.
template <typename T>
TT3D_HD bool set_functions(const T* clip, const int32_t* face, TriangleSetup& setup) {
  return screen_functions(load_triangle(clip, face), setup.edge, setup.depth);
}

/// Sets up a triangle for the whole picture. False if it cannot cover a pixel (behind the camera,
/// no pixel centre within its bounds, no area, not finite).
template <typename T>
TT3D_HD bool setup_triangle(const T* clip, const int32_t* face, int64_t height, int64_t width,
                            TriangleSetup& setup) {
  VertexBounds at[3];
  for (int k = 0; k < 3; ++k) at[k] = vertex_bounds(load_vertex(clip, face[k]), height, width);
  if (!set_bounds(at[0], at[1], at[2], setup)) return false;
  return set_functions(clip, face, setup);
}

/// A covered pixel: the values of the edge functions and the depth z/w.
struct Hit {
  double e[3];
  double zw;
  /// Factor that turns the edge function values into perspective-correct barycentric weights.
  [[nodiscard]] TT3D_HD double scale() const { return 1 / (e[0] + e[1] + e[2]); }
};

/// Whether the pixel with edge function values e lies inside.
TT3D_HD bool inside(const TriangleSetup& t, const double e[3]) {
  const double smallest = least(e[0], e[1], e[2]);
  if (smallest != 0) return smallest > 0;
  for (int k = 0; k < 3; ++k) {
    if (t.edge[k].sign_at(e[k]) <= 0) return false;
  }
  return e[0] + e[1] + e[2] != 0;
}

/// Whether a depth z/w lies between the near and the far plane. (Value: see pixel_x; it may be a
/// vector, hence no branches.)
template <typename Value>
TT3D_HD auto in_depth(const Value& zw) {
  return (zw >= -1) & (zw <= 1);
}

/// Whether the triangle covers the pixel at (px,py); fills `hit` if so.
TT3D_HD bool hit_triangle(const TriangleSetup& t, double px, double py, Hit& hit) {
  for (int k = 0; k < 3; ++k) hit.e[k] = t.edge[k].at(px, py);
  hit.zw = t.depth.at(px, py);
  return inside(t, hit.e) && in_depth(hit.zw);
}

/// A vertex in clip space without its depth. (Value: see pixel_x.)
template <typename Value>
struct FlatVertex {
  Value x, y, w;
};

template <typename T>
TT3D_HD void load_flat_triangle(const T* clip, const int32_t* face, FlatVertex<double> corner[3]) {
  for (int k = 0; k < 3; ++k) {
    const ClipVertex v = load_vertex(clip, face[k]);
    corner[k] = {v.x, v.y, v.w};
  }
}

/// What a pixel's gradient adds to a triangle's vertices is a row times the vertex's weight u, v or
/// 1 - u - v: at the pixel, sum_k u_k p_k is parallel to (P,1), so moving vertex k by d moves the
/// sum by u_k d. With p' = p.xy - P p.w and differences relative to vertex 2, u = cross(p1', p2') /
/// cross(d0, d1), and the row is (gx, gy, -P.(gx,gy)). It does not change when P moves along its
/// own ray.
template <typename Value>
TT3D_HD FlatVertex<Value> rasterize_backward(const FlatVertex<Value> corner[3], const Value& px,
                                             const Value& py, const Value& grad_u,
                                             const Value& grad_v) {
  const FlatVertex<Value>&p = corner[0], &q = corner[1], &r = corner[2];
  const Value w0 = p.w - r.w, w1 = q.w - r.w;
  const Value x0 = p.x - r.x - px * w0, y0 = p.y - r.y - py * w0;
  const Value x1 = q.x - r.x - px * w1, y1 = q.y - r.y - py * w1;
  const Value area = x0 * y1 - x1 * y0;
  const Value inverse = area == 0.0 ? Value{} : 1.0 / area;
  const Value gx = (grad_v * y0 - grad_u * y1) * inverse;
  const Value gy = (grad_u * x1 - grad_v * x0) * inverse;
  return {gx, gy, -(px * gx + py * gy)};
}

/// Body of rasterize's backward pass: pixel i adds to the vertices of its triangle.
template <typename T>
struct RasterizeBackwardPixel {
  const T* clip;
  const int32_t* faces;
  const T* rast;
  const T* grad_rast;
  T* grad_clip;
  Sizes s;
  /// The triangle whose vertices receive a gradient from pixel i, -1 if none do.
  [[nodiscard]] TT3D_HD int64_t face_at(int64_t i) const {
    if (grad_rast[4 * i] == 0 && grad_rast[4 * i + 1] == 0) return -1;
    return static_cast<int64_t>(rast[4 * i + 3]) - 1;
  }
};

/// Terms of a triangle that the derivatives of (u,v) depend on.
struct BarycentricSlopes {
  ScreenFunction edge[2], sum;  ///< sum of all three edges; u = edge[0] / sum
};

template <typename T>
TT3D_HD BarycentricSlopes barycentric_slopes(const T* clip, const int32_t* face) {
  ScreenFunction e[3];
  edges_of(load_triangle(clip, face), e);
  return {{e[0], e[1]},
          {e[0].a + e[1].a + e[2].a, e[0].b + e[1].b + e[2].b, e[0].c + e[1].c + e[2].c}};
}

/// Offset from a pixel to the next one to the right and below, in normalised device coordinates.
struct PixelSteps {
  double x, y;
  TT3D_HD explicit PixelSteps(const Sizes& s)
      : x(2.0 / static_cast<double>(s.width)), y(-2.0 / static_cast<double>(s.height)) {}
};

/// Derivatives of (u,v) with respect to the pixel's position, per pixel, y down.
/// out = {du/dx, du/dy, dv/dx, dv/dy}.
TT3D_HD void barycentric_derivatives(const BarycentricSlopes& t, double px, double py,
                                     const PixelSteps& step, double out[4]) {
  const double sum = t.sum.at(px, py);
  const double inverse = sum != 0 ? 1.0 / sum : 0.0;
  for (int k = 0; k < 2; ++k) {
    const double weight = t.edge[k].at(px, py) * inverse;
    double* row = out + 2 * static_cast<int64_t>(k);
    row[0] = (t.edge[k].a - weight * t.sum.a) * inverse * step.x;
    row[1] = (t.edge[k].b - weight * t.sum.b) * inverse * step.y;
  }
}

}  // namespace tt3d::raster
