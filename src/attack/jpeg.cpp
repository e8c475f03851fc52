#include <ATen/ATen.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "tt3d/eot.h"

namespace tt3d::attack {
namespace {

using at::Tensor;
using Table = std::array<int, 64>;

// Quantisation tables of ITU-T T.81, annex K.1; each line is one row of the block.
constexpr Table kLuminance = {16, 11, 10, 16, 24,  40,  51,  61,   //
                              12, 12, 14, 19, 26,  58,  60,  55,   //
                              14, 13, 16, 24, 40,  57,  69,  56,   //
                              14, 17, 22, 29, 51,  87,  80,  62,   //
                              18, 22, 37, 56, 68,  109, 103, 77,   //
                              24, 35, 55, 64, 81,  104, 113, 92,   //
                              49, 64, 78, 87, 103, 121, 120, 101,  //
                              72, 92, 95, 98, 112, 100, 103, 99};
constexpr Table kChrominance = {17, 18, 24, 47, 99, 99, 99, 99,  //
                                18, 21, 26, 66, 99, 99, 99, 99,  //
                                24, 26, 56, 99, 99, 99, 99, 99,  //
                                47, 66, 99, 99, 99, 99, 99, 99,  //
                                99, 99, 99, 99, 99, 99, 99, 99,  //
                                99, 99, 99, 99, 99, 99, 99, 99,  //
                                99, 99, 99, 99, 99, 99, 99, 99,  //
                                99, 99, 99, 99, 99, 99, 99, 99};

/// The table that libjpeg uses for a quality (jcparam.c, jpeg_quality_scaling).
std::array<double, 64> scaled(const Table& table, int quality) {
  const int percent = quality < 50 ? 5000 / quality : 200 - 2 * quality;
  std::array<double, 64> out{};
  for (size_t i = 0; i < out.size(); ++i) {
    out[i] = std::clamp((table[i] * percent + 50) / 100, 1, 255);
  }
  return out;
}

/// Tables of all pictures, [N,1,1,8,8], with the dtype and device of `like`.
Tensor tables(const Table& table, const std::vector<int>& qualities, const Tensor& like) {
  Tensor out = at::empty({static_cast<int64_t>(qualities.size()), 1, 1, 8, 8}, at::kDouble);
  auto* p = out.mutable_data_ptr<double>();
  for (const int quality : qualities) {
    for (const double x : scaled(table, quality)) *p++ = x;
  }
  return out.to(like.options());
}

/// The orthonormal cosine transform of 8 samples: [8,8], one row per frequency.
Tensor cosine_matrix(const Tensor& like) {
  Tensor m = at::empty({8, 8}, at::kDouble);
  auto* p = m.mutable_data_ptr<double>();
  for (int k = 0; k < 8; ++k) {
    for (int i = 0; i < 8; ++i) {
      *p++ = (k == 0 ? std::sqrt(0.125) : 0.5) * std::cos((2 * i + 1) * k * std::numbers::pi / 16);
    }
  }
  return m.to(like.options());
}

Tensor smooth_round(const Tensor& x) {
  const Tensor nearest = x.detach().round();
  return nearest + (x - nearest).pow(3);
}

/// Quantises a plane [N,H,W] of values around 0, H and W multiples of 8, by tables [N,1,1,8,8].
Tensor quantize(const Tensor& plane, const Tensor& table, const Tensor& cosines) {
  const int64_t n = plane.size(0), height = plane.size(1), width = plane.size(2);
  const Tensor blocks = plane.reshape({n, height / 8, 8, width / 8, 8}).permute({0, 1, 3, 2, 4});
  const Tensor frequencies = at::matmul(at::matmul(cosines, blocks), cosines.t());
  const Tensor kept = smooth_round(frequencies / table) * table;
  return at::matmul(at::matmul(cosines.t(), kept), cosines)
      .permute({0, 1, 3, 2, 4})
      .reshape({n, height, width});
}

/// A linear map of the three colours; the rows [3,3] come from JFIF 1.02.
Tensor mix(const Tensor& images, const std::array<double, 9>& rows) {
  const Tensor m = at::tensor(at::ArrayRef<double>(rows), at::kDouble).view({3, 3});
  return at::einsum("kc,nchw->nkhw", {m.to(images.options()), images});
}

}  // namespace

Tensor jpeg_stand_in(const Tensor& images, const std::vector<int>& qualities) {
  constexpr int64_t kUnit = 16;  // an 8x8 block of halved chroma covers 16x16 pixels
  const int64_t height = images.size(2), width = images.size(3);
  const int64_t below = (kUnit - height % kUnit) % kUnit, right = (kUnit - width % kUnit) % kUnit;
  const Tensor whole = at::replication_pad2d(images * 255, {0, right, 0, below});
  const Tensor ycc = mix(whole, {0.299, 0.587, 0.114, -0.168735892, -0.331264108, 0.5, 0.5,
                                 -0.418687589, -0.081312411});
  const Tensor cosines = cosine_matrix(images);
  const Tensor chroma_table = tables(kChrominance, qualities, images);
  const Tensor luma =
      quantize(ycc.select(1, 0) - 128, tables(kLuminance, qualities, images), cosines) + 128;
  const Tensor halved = at::avg_pool2d(ycc.narrow(1, 1, 2), {2, 2});
  const Tensor coded = at::stack({quantize(halved.select(1, 0), chroma_table, cosines),
                                  quantize(halved.select(1, 1), chroma_table, cosines)},
                                 1);
  // Bilinear interpolation equals the triangle filter of libjpeg's decoder.
  const Tensor chroma = at::upsample_bilinear2d(coded, {whole.size(2), whole.size(3)}, false);
  const Tensor rgb = mix(at::cat({luma.unsqueeze(1), chroma}, 1),
                         {1, 0, 1.402, 1, -0.344136286, -0.714136286, 1, 1.772, 0});
  return (rgb.narrow(2, 0, height).narrow(3, 0, width) / 255).clamp(0, 1);
}

}  // namespace tt3d::attack
