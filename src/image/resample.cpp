#include <ATen/ATen.h>

#include <algorithm>
#include <vector>

#include "tt3d/image.h"
#include "tt3d/pixel_sum.h"

namespace tt3d::image {

using at::Tensor;

namespace {

/// The source pixels that a target pixel covers along an axis, with their weights.
struct Span {
  int first = 0;
  std::vector<float> weights;  ///< sum to 1
};

std::vector<Span> box_spans(int from, int to) {
  std::vector<Span> spans(static_cast<size_t>(to));
  const double ratio = static_cast<double>(from) / to;
  for (int i = 0; i < to; ++i) {
    const double low = i * ratio;
    const double high = std::min<double>(from, (i + 1) * ratio);
    Span& span = spans[static_cast<size_t>(i)];
    span.first = static_cast<int>(low);
    for (int p = span.first; p < high; ++p) {
      const double covered = std::min<double>(p + 1, high) - std::max<double>(p, low);
      span.weights.push_back(static_cast<float>(covered / ratio));
    }
  }
  return spans;
}

}  // namespace

Tensor downscale(const Tensor& rgba, int width, int height) {
  const Tensor source = rgba.contiguous();
  const auto from_width = source.size(1);
  const std::vector<Span> columns = box_spans(static_cast<int>(from_width), width);
  const std::vector<Span> rows = box_spans(static_cast<int>(source.size(0)), height);
  Tensor result = at::empty({height, width, 4}, at::kByte);
  const uint8_t* pixels = source.data_ptr<uint8_t>();
  uint8_t* out = result.data_ptr<uint8_t>();
  for (const Span& row : rows) {
    for (const Span& column : columns) {
      PixelSum sum;
      for (size_t j = 0; j < row.weights.size(); ++j) {
        const uint8_t* line =
            pixels + ((row.first + static_cast<int64_t>(j)) * from_width + column.first) * 4;
        for (size_t i = 0; i < column.weights.size(); ++i) {
          sum.add(line + 4 * i, row.weights[j] * column.weights[i]);
        }
      }
      sum.store(out);
      out += 4;
    }
  }
  return result;
}

Tensor average_pixels(const Tensor& pictures, int64_t factor) {
  const Tensor alpha = pictures.narrow(3, 3, 1);
  const Tensor srgb = (pictures.narrow(3, 0, 3) / alpha.clamp_min(1e-6)).clamp(0, 1);
  const Tensor mean =
      at::avg_pool2d(at::cat({srgb_to_linear(srgb) * alpha, alpha}, 3).permute({0, 3, 1, 2}),
                     factor)
          .permute({0, 2, 3, 1});
  const Tensor share = mean.narrow(3, 3, 1);
  const Tensor inside = (mean.narrow(3, 0, 3) / share.clamp_min(1e-6)).clamp(0, 1);
  return at::cat({linear_to_srgb(inside) * share, share}, 3).contiguous();
}

}  // namespace tt3d::image
