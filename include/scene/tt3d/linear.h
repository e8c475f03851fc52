#pragma once

#include <array>
#include <cmath>

/// Vectors of three and row-major 4x4 matrices in double, for cameras.
namespace tt3d::scene::linear {

using Vec3 = std::array<double, 3>;
using Mat4 = std::array<double, 16>;

inline Vec3 operator+(const Vec3& a, const Vec3& b) {
  return {a[0] + b[0], a[1] + b[1], a[2] + b[2]};
}
inline Vec3 operator-(const Vec3& a, const Vec3& b) {
  return {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
}
inline Vec3 operator*(double s, const Vec3& a) { return {s * a[0], s * a[1], s * a[2]}; }
inline double dot(const Vec3& a, const Vec3& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
inline Vec3 cross(const Vec3& a, const Vec3& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
inline double length(const Vec3& a) { return std::sqrt(dot(a, a)); }
inline Vec3 normalized(const Vec3& a) { return (1.0 / length(a)) * a; }

inline Vec3 column(const Mat4& m, int c) { return {m[c], m[4 + c], m[8 + c]}; }
inline void set_column(Mat4& m, int c, const Vec3& v) {
  for (int r = 0; r < 3; ++r) m[4 * r + c] = v[r];
}
/// The rigid matrix with these axes and origin.
inline Mat4 frame(const Vec3& x, const Vec3& y, const Vec3& z, const Vec3& origin) {
  Mat4 m{};
  set_column(m, 0, x);
  set_column(m, 1, y);
  set_column(m, 2, z);
  set_column(m, 3, origin);
  m[15] = 1;
  return m;
}
/// The matrix product a b.
inline Mat4 product(const Mat4& a, const Mat4& b) {
  Mat4 out{};
  for (int r = 0; r < 4; ++r) {
    for (int c = 0; c < 4; ++c) {
      for (int k = 0; k < 4; ++k) out[4 * r + c] += a[4 * r + k] * b[4 * k + c];
    }
  }
  return out;
}
/// Transforms a world point into the frame of a rigid matrix (applies its inverse).
inline Vec3 to_local(const Mat4& m, const Vec3& p) {
  const Vec3 d = p - column(m, 3);
  return {dot(column(m, 0), d), dot(column(m, 1), d), dot(column(m, 2), d)};
}

/// The smallest rotation that turns the unit vector `up` to +Z, as a matrix without translation.
inline Mat4 rotation_to_z(const Vec3& up) {
  if (up[2] < -1 + 1e-9) return frame({1, 0, 0}, {0, -1, 0}, {0, 0, -1}, {0, 0, 0});
  // Rodrigues' formula with axis up x z.
  const double a = up[0], b = up[1], k = 1 / (1 + up[2]);
  return {1 - k * a * a,
          -k * a * b,
          -a,
          0,  //
          -k * a * b,
          1 - k * b * b,
          -b,
          0,  //
          a,
          b,
          up[2],
          0,  //
          0,
          0,
          0,
          1};
}
/// The transpose of a matrix without translation: the inverse of a rotation.
inline Mat4 transposed(const Mat4& m) {
  Mat4 out{};
  for (int r = 0; r < 4; ++r) {
    for (int c = 0; c < 4; ++c) out[4 * c + r] = m[4 * r + c];
  }
  return out;
}
/// A vector rotated by a matrix without translation.
inline Vec3 rotated(const Mat4& m, const Vec3& v) {
  return v[0] * column(m, 0) + v[1] * column(m, 1) + v[2] * column(m, 2);
}

}  // namespace tt3d::scene::linear
