#pragma once

#include <cmath>
#include <cstdint>

#include "tt3d/kernel.h"

/// Bodies of rasterize: one triangle, one pixel. No tensor library here.
namespace tt3d::raster {

/// Sizes shared by the operators.
struct Sizes {
  int64_t views, vertices, faces, height, width, channels;
  [[nodiscard]] TT3D_HD int64_t pixels() const { return views * height * width; }
};

/// Where pixel i of all views lies.
struct PixelPlace {
  int64_t view, row, column;
};

TT3D_HD PixelPlace place_of(int64_t i, const Sizes& s) {
  const int64_t line = i / s.width;
  return {line / s.height, line % s.height, i % s.width};
}

/// A vertex in clip space, in the type of the computation.
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

/// Edge function e(px,py) = a px + b py + c of the directed edge through two clip vertices;
/// positive to its left. Doubles, because the terms cancel almost completely on small triangles.
struct EdgeFunction {
  double a, b, c;
  /// Its two parts, so that a column and a row of pixels need each once; the value is their sum.
  template <typename Value>
  [[nodiscard]] TT3D_HD Value of_column(const Value& px) const {
    return a * px;
  }
  [[nodiscard]] TT3D_HD double of_row(double py) const { return b * py + c; }
  [[nodiscard]] TT3D_HD double at(double px, double py) const { return of_column(px) + of_row(py); }
  /// Sign at (px,py), never 0 for a real edge: a pixel exactly on the edge counts as if moved by
  /// (eps, eps^2), so that every point belongs to exactly one side, consistently at vertices too.
  TT3D_HD int sign_at(double value) const {
    if (value != 0) return value > 0 ? 1 : -1;
    if (a != 0) return a > 0 ? 1 : -1;
    return b > 0 ? 1 : (b < 0 ? -1 : 0);
  }
};

/// The edge from vertex `i` to `j`, computed in order of their indices so that both triangles at
/// the edge see the same bits up to the sign.
TT3D_HD EdgeFunction edge_function(const ClipVertex& vi, const ClipVertex& vj, int32_t i,
                                   int32_t j) {
  const bool swap = i > j;
  const ClipVertex& p = swap ? vj : vi;
  const ClipVertex& q = swap ? vi : vj;
  const double sign = swap ? -1.0 : 1.0;
  // cross(p - P p.w, q - P q.w) expanded in the pixel P.
  return {sign * (p.y * q.w - p.w * q.y), sign * (p.w * q.x - p.x * q.w),
          sign * (p.x * q.y - p.y * q.x)};
}

/// What a triangle needs to be tested at pixels.
struct TriangleSetup {
  EdgeFunction edge[3];  ///< edge k is opposite vertex k
  double z[3], w[3];
  int x_begin, x_end, y_begin, y_end;  ///< pixel range that can be covered
};

/// Coordinate of pixel column c in normalised device coordinates.
TT3D_HD double pixel_x(int64_t c, int64_t width) {
  const double inverse = 1.0 / static_cast<double>(width);  // once a loop, not once a pixel
  return (2.0 * static_cast<double>(c) + 1.0) * inverse - 1.0;
}

/// Coordinate of pixel row r, row 0 at the top (y = +1).
TT3D_HD double pixel_y(int64_t r, int64_t height) {
  const double inverse = 1.0 / static_cast<double>(height);
  return 1.0 - (2.0 * static_cast<double>(r) + 1.0) * inverse;
}

/// The smallest pixel in [0,limit] that is not below `value`; NaN gives 0. (Not std::ceil, which is
/// a call on processors without SSE4.1, the build's baseline.)
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

/// Value: double, or on the CPU a vector of them.
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

/// Where a vertex lies in the picture, in pixels (that of row and column 0 having its centre at 0).
struct ScreenPoint {
  double x, y;
  bool in_front;  ///< of the camera; otherwise there is no place
};

TT3D_HD ScreenPoint screen_point(const ClipVertex& v, int64_t height, int64_t width) {
  if (!(v.w > 0)) return {0, 0, false};
  const double inverse = 1 / v.w;
  return {(v.x * inverse + 1) * (0.5 * static_cast<double>(width)) - 0.5,
          (1 - v.y * inverse) * (0.5 * static_cast<double>(height)) - 0.5, true};
}

/// Pixel range of a triangle, the whole picture when a vertex is behind the camera; false when it
/// is empty.
TT3D_HD bool set_bounds(const ScreenPoint& p, const ScreenPoint& q, const ScreenPoint& r,
                        int64_t height, int64_t width, TriangleSetup& setup) {
  setup.x_begin = 0;
  setup.y_begin = 0;
  setup.x_end = static_cast<int>(width);
  setup.y_end = static_cast<int>(height);
  if (!(p.in_front && q.in_front && r.in_front)) return p.in_front || q.in_front || r.in_front;
  // A margin covers rounding, the edge functions decide.
  constexpr double kMargin = 1e-6;
  setup.x_begin = pixel_from(least(p.x, q.x, r.x) - kMargin, width);
  setup.x_end = pixel_past(greatest(p.x, q.x, r.x) + kMargin, width);
  setup.y_begin = pixel_from(least(p.y, q.y, r.y) - kMargin, height);
  setup.y_end = pixel_past(greatest(p.y, q.y, r.y) + kMargin, height);
  return setup.x_begin < setup.x_end && setup.y_begin < setup.y_end;
}

/// Prepares the edges of a triangle whose bounds are set.
template <typename T>
TT3D_HD void set_edges(const T* clip, const int32_t* face, TriangleSetup& setup) {
  const ClipTriangle v = load_triangle(clip, face);
  for (int k = 0; k < 3; ++k) {
    const int i = (k + 1) % 3;
    const int j = (k + 2) % 3;
    setup.edge[k] = edge_function(v.corner[i], v.corner[j], face[i], face[j]);
    setup.z[k] = v.corner[k].z;
    setup.w[k] = v.corner[k].w;
  }
}

/// Prepares a triangle for the whole picture. False when it cannot cover a pixel (behind the
/// camera, no pixel centre within its bounds, not finite).
template <typename T>
TT3D_HD bool setup_triangle(const T* clip, const int32_t* face, int64_t height, int64_t width,
                            TriangleSetup& setup) {
  ScreenPoint at[3];
  for (int k = 0; k < 3; ++k) at[k] = screen_point(load_vertex(clip, face[k]), height, width);
  if (!set_bounds(at[0], at[1], at[2], height, width, setup)) return false;
  set_edges(clip, face, setup);
  return true;
}

/// A covered pixel: the edge functions' values there, and the depth z/w.
struct Hit {
  double e[3];
  double zw;
  /// The factor that makes the edge functions' values the perspective-correct weights.
  [[nodiscard]] TT3D_HD double scale() const { return 1 / (e[0] + e[1] + e[2]); }
};

/// Whether the pixel at which the edge functions have values e lies inside: strictly on the same
/// side of all edges. (Value: see `least`; hence no branches here and in `depth_at`.)
template <typename Value>
TT3D_HD auto strictly_inside(const Value e[3]) {
  return (least(e[0], e[1], e[2]) > 0) | (greatest(e[0], e[1], e[2]) < 0);
}

/// Whether it lies on an edge, so that `inside` has to break a tie.
template <typename Value>
TT3D_HD auto on_an_edge(const Value e[3]) {
  return (e[0] == 0) | (e[1] == 0) | (e[2] == 0);
}

/// Whether it lies inside.
TT3D_HD bool inside(const TriangleSetup& t, const double e[3]) {
  if (strictly_inside(e)) return true;
  if (!on_an_edge(e)) return false;
  const int side = t.edge[0].sign_at(e[0]);
  return side != 0 && t.edge[1].sign_at(e[1]) == side && t.edge[2].sign_at(e[2]) == side &&
         e[0] + e[1] + e[2] != 0;
}

/// The depth of a hit; false when it is behind the camera or beyond the near or far plane.
template <typename Value>
TT3D_HD auto depth_at(const TriangleSetup& t, const Value e[3], Value& zw) {
  // Both share the factor 1 / (e0 + e1 + e2), which the depth does not need.
  const Value w = e[0] * t.w[0] + e[1] * t.w[1] + e[2] * t.w[2];
  const Value z = e[0] * t.z[0] + e[1] * t.z[1] + e[2] * t.z[2];
  zw = z / w;
  return ((w > 0) == (e[0] + e[1] + e[2] > 0)) & (w != 0) & (zw >= -1) & (zw <= 1);
}

/// Whether the triangle covers the pixel at (px,py), and where.
TT3D_HD bool hit_triangle(const TriangleSetup& t, double px, double py, Hit& hit) {
  for (int k = 0; k < 3; ++k) hit.e[k] = t.edge[k].at(px, py);
  return inside(t, hit.e) && depth_at(t, hit.e, hit.zw);
}

/// Whether a hit hides what a pixel shows so far: the nearest wins, at equal depth the lower index,
/// whatever the order in which the triangles come.
TT3D_HD bool hides(double depth, int64_t face, double shown_depth, int64_t shown_face) {
  return depth < shown_depth || (depth == shown_depth && face < shown_face);
}

/// The numbers of a triangle that its pixels' gradients depend on. (Value: see `least`.)
template <typename Value>
struct FlatTriangle {
  Value x[3], y[3], w[3];
};

/// Backward of one pixel's (u,v): sets grad[3][4], the gradients of the triangle's vertices but for
/// those of z, which are 0. With p' = p.xy - P p.w and a_k = cross of the other two p',
/// u = a_0/sum a, v = a_1/sum a.
template <typename Value>
TT3D_HD void rasterize_backward(const FlatTriangle<Value>& t, const Value& px, const Value& py,
                                const Value& grad_u, const Value& grad_v, Value grad[3][4]) {
  Value x[3], y[3];
  for (int k = 0; k < 3; ++k) {
    x[k] = t.x[k] - px * t.w[k];
    y[k] = t.y[k] - py * t.w[k];
  }
  Value a[3];
  for (int k = 0; k < 3; ++k) {
    const int i = (k + 1) % 3, j = (k + 2) % 3;
    a[k] = x[i] * y[j] - x[j] * y[i];
  }
  const Value sum = a[0] + a[1] + a[2], one = sum * 0 + 1;
  const Value inverse = sum == 0 ? sum : one / sum;
  const Value mean = (grad_u * a[0] + grad_v * a[1]) * inverse;
  const Value grad_a[3] = {(grad_u - mean) * inverse, (grad_v - mean) * inverse, -mean * inverse};
  for (int k = 0; k < 3; ++k) {
    const int i = (k + 1) % 3, j = (k + 2) % 3;
    // Vertex k enters a_j = cross(p_k, p_i) and a_i = cross(p_j, p_k).
    grad[k][0] = grad_a[j] * y[i] - grad_a[i] * y[j];
    grad[k][1] = grad_a[i] * x[j] - grad_a[j] * x[i];
    grad[k][3] = -(px * grad[k][0] + py * grad[k][1]);
  }
}

/// Body of rasterize's backward pass: pixel i adds to its triangle's vertices.
template <typename T>
struct RasterizeBackwardPixel {
  const T* clip;
  const int32_t* faces;
  const T* rast;
  const T* grad_rast;
  T* grad_clip;
  Sizes s;
  TT3D_HD void operator()(int64_t i) const {
    const auto face = static_cast<int64_t>(rast[4 * i + 3]) - 1;
    if (face < 0) return;
    const PixelPlace at = place_of(i, s);
    const int64_t first = at.view * s.vertices * 4;
    const ClipTriangle v = load_triangle(clip + first, faces + 3 * face);
    FlatTriangle<double> t;
    for (int k = 0; k < 3; ++k) {
      t.x[k] = v.corner[k].x;
      t.y[k] = v.corner[k].y;
      t.w[k] = v.corner[k].w;
    }
    double grad[3][4] = {};
    rasterize_backward(t, pixel_x(at.column, s.width), pixel_y(at.row, s.height),
                       static_cast<double>(grad_rast[4 * i]),
                       static_cast<double>(grad_rast[4 * i + 1]), grad);
    for (int k = 0; k < 3; ++k) {
      T* out = grad_clip + first + static_cast<int64_t>(faces[3 * face + k]) * 4;
      for (int c = 0; c < 4; ++c) accumulate(out + c, static_cast<T>(grad[k][c]));
    }
  }
};

/// Derivatives of (u,v) with respect to the pixel's position, per pixel, y down.
/// out = {du/dx, du/dy, dv/dx, dv/dy}.
template <typename T>
TT3D_HD void barycentric_derivatives(const T* clip, const int32_t* face, double px, double py,
                                     int64_t height, int64_t width, double out[4]) {
  EdgeFunction e[3];
  double value[3];
  for (int k = 0; k < 3; ++k) {
    const int i = (k + 1) % 3, j = (k + 2) % 3;
    e[k] = edge_function(load_vertex(clip, face[i]), load_vertex(clip, face[j]), face[i], face[j]);
    value[k] = e[k].at(px, py);
  }
  const double sum = value[0] + value[1] + value[2];
  const double sum_x = e[0].a + e[1].a + e[2].a;
  const double sum_y = e[0].b + e[1].b + e[2].b;
  const double x_step = 2.0 / static_cast<double>(width);
  const double y_step = -2.0 / static_cast<double>(height);
  const double inverse = sum != 0 ? 1.0 / sum : 0.0;
  for (int k = 0; k < 2; ++k) {
    const double weight = value[k] * inverse;
    double* row = out + 2 * static_cast<int64_t>(k);
    row[0] = (e[k].a - weight * sum_x) * inverse * x_step;
    row[1] = (e[k].b - weight * sum_y) * inverse * y_step;
  }
}

}  // namespace tt3d::raster
