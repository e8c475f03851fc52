#pragma once

#include <array>

/// 4x4 matrices, column-major as in glTF.
namespace tt3d::asset {

using Matrix = std::array<double, 16>;
using Vector = std::array<double, 3>;

inline constexpr Matrix kIdentity = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};

inline Matrix multiply(const Matrix& a, const Matrix& b) {
  Matrix out{};
  for (size_t c = 0; c < 4; ++c) {
    for (size_t r = 0; r < 4; ++r) {
      for (size_t k = 0; k < 4; ++k) out[4 * c + r] += a[4 * k + r] * b[4 * c + k];
    }
  }
  return out;
}

/// Of the upper left 3x3 block.
inline double determinant(const Matrix& m) {
  return m[0] * (m[5] * m[10] - m[9] * m[6]) - m[4] * (m[1] * m[10] - m[9] * m[2]) +
         m[8] * (m[1] * m[6] - m[5] * m[2]);
}

inline Vector transform(const Matrix& m, const Vector& p) {
  Vector q{};
  for (size_t r = 0; r < 3; ++r) {
    q[r] = m[r] * p[0] + m[4 + r] * p[1] + m[8 + r] * p[2] + m[12 + r];
  }
  return q;
}

/// translation * rotation * scale; `rotation` is a unit quaternion (x, y, z, w).
inline Matrix compose(const Vector& t, const std::array<double, 4>& rotation, const Vector& s) {
  const auto& [x, y, z, w] = rotation;
  return {s[0] * (1 - 2 * (y * y + z * z)),
          s[0] * 2 * (x * y + z * w),
          s[0] * 2 * (x * z - y * w),
          0,
          s[1] * 2 * (x * y - z * w),
          s[1] * (1 - 2 * (x * x + z * z)),
          s[1] * 2 * (y * z + x * w),
          0,
          s[2] * 2 * (x * z + y * w),
          s[2] * 2 * (y * z - x * w),
          s[2] * (1 - 2 * (x * x + y * y)),
          0,
          t[0],
          t[1],
          t[2],
          1};
}

}  // namespace tt3d::asset
