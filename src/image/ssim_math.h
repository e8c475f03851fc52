#pragma once

#include "tt3d/kernel.h"

/// Structural similarity of one window (Wang et al., "Image quality assessment: from error
/// visibility to structural similarity", 2004, equation 13) and its gradient.
namespace tt3d::image::similarity {

constexpr int kTaps = 11;
constexpr double kSigma = 1.5;
constexpr double kC1 = 0.01 * 0.01, kC2 = 0.03 * 0.03;

/// Weighted means of x, y, x^2, y^2 and xy over a window.
enum Moment { kX, kY, kXX, kYY, kXY, kMoments };

/// The window's similarity. slope[3], if not null, receives its derivatives with respect to the
/// means of x, x^2 and xy: the similarity depends on x only through these.
template <typename T>
TT3D_HD T similarity(const T m[kMoments], T* slope) {
  const T means = m[kX] * m[kX] + m[kY] * m[kY];
  const T a1 = 2 * m[kX] * m[kY] + T(kC1), a2 = 2 * (m[kXY] - m[kX] * m[kY]) + T(kC2);
  const T b1 = means + T(kC1), b2 = m[kXX] + m[kYY] - means + T(kC2);
  const T inverse = 1 / (b1 * b2), value = a1 * a2 * inverse;
  if (slope) {
    // d(a1 a2) = 2 y (a2 - a1) dx and d(b1 b2) = 2 x (b2 - b1) dx for the mean x.
    slope[0] = 2 * (m[kY] * (a2 - a1) - value * m[kX] * (b2 - b1)) * inverse;
    slope[1] = -value * b1 * inverse;
    slope[2] = 2 * a1 * inverse;
  }
  return value;
}

}  // namespace tt3d::image::similarity
