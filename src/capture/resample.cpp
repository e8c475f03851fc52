#include "resample.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>

namespace tt3d {
namespace {

/// The source pixels under one target pixel along an axis, with their coverage.
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

/// Premultiplied sum with a weight: colours in 0..255, times alpha in 0..1.
struct Sum {
  float rgb[3] = {};
  float alpha = 0;
  void add(const uint8_t* pixel, float weight) {
    const float a = weight * static_cast<float>(pixel[3]) / 255.F;
    for (int c = 0; c < 3; ++c) rgb[c] += a * static_cast<float>(pixel[c]);
    alpha += a;
  }
  /// Back to straight alpha.
  void store(uint8_t* pixel) const {
    const float a = std::min(alpha, 1.F);
    pixel[3] = static_cast<uint8_t>(a * 255.F + 0.5F);
    for (int c = 0; c < 3; ++c) {
      const float straight = pixel[3] == 0 ? 0.F : rgb[c] / alpha;
      pixel[c] = static_cast<uint8_t>(std::clamp(straight, 0.F, 255.F) + 0.5F);
    }
  }
};

/// Bilinear sample at pixel coordinates (centres at .5). Outside counts as transparent if
/// `has_mask`, else as the nearest edge pixel.
Sum sample_bilinear(const uint8_t* image, int width, int height, double u, double v,
                    bool has_mask) {
  const double x = std::clamp(u - 0.5, -2.0, width + 1.0);
  const double y = std::clamp(v - 0.5, -2.0, height + 1.0);
  const int x0 = static_cast<int>(std::floor(x));
  const int y0 = static_cast<int>(std::floor(y));
  const auto fx = static_cast<float>(x - x0);
  const auto fy = static_cast<float>(y - y0);
  Sum sum;
  for (int corner = 0; corner < 4; ++corner) {
    const int px = x0 + (corner & 1);
    const int py = y0 + (corner >> 1);
    const bool outside = px < 0 || py < 0 || px >= width || py >= height;
    if (outside && has_mask) continue;
    const int cx = std::clamp(px, 0, width - 1);
    const int cy = std::clamp(py, 0, height - 1);
    const float weight = ((corner & 1) != 0 ? fx : 1 - fx) * ((corner >> 1) != 0 ? fy : 1 - fy);
    sum.add(image + (int64_t{cy} * width + cx) * 4, weight);
  }
  return sum;
}

}  // namespace

at::Tensor downscale(const at::Tensor& rgba, int width, int height) {
  const at::Tensor source = rgba.contiguous();
  const auto from_width = source.size(1);
  const std::vector<Span> columns = box_spans(static_cast<int>(from_width), width);
  const std::vector<Span> rows = box_spans(static_cast<int>(source.size(0)), height);
  at::Tensor result = at::empty({height, width, 4}, at::kByte);
  const uint8_t* pixels = source.data_ptr<uint8_t>();
  uint8_t* out = result.data_ptr<uint8_t>();
  for (const Span& row : rows) {
    for (const Span& column : columns) {
      Sum sum;
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

void limit_size(View& view, int max_size) {
  Camera& camera = view.camera;
  const int longer = std::max(camera.width, camera.height);
  if (max_size <= 0 || longer <= max_size) return;
  const auto scaled = [&](int side) {
    return std::max(1,
                    static_cast<int>(std::lround(side * static_cast<double>(max_size) / longer)));
  };
  const int width = scaled(camera.width);
  const int height = scaled(camera.height);
  view.rgba = downscale(view.rgba, width, height);
  const double sx = static_cast<double>(width) / camera.width;
  const double sy = static_cast<double>(height) / camera.height;
  camera.fx *= sx;
  camera.cx *= sx;
  camera.fy *= sy;
  camera.cy *= sy;
  camera.width = width;
  camera.height = height;
}

bool distort(const Distortion& d, double x, double y, double& out_x, double& out_y) {
  const double r2 = x * x + y * y;
  const double radial = 1 + r2 * (d.k1 + r2 * d.k2);
  out_x = x * radial + 2 * d.p1 * x * y + d.p2 * (r2 + 2 * x * x);
  out_y = y * radial + d.p1 * (r2 + 2 * y * y) + 2 * d.p2 * x * y;
  return 1 + r2 * (3 * d.k1 + 5 * r2 * d.k2) > 0;
}

at::Tensor undistort(const at::Tensor& rgba, const Camera& camera, const Distortion& distortion,
                     bool has_mask) {
  const at::Tensor source = rgba.contiguous();
  at::Tensor result = at::zeros_like(source);
  const uint8_t* pixels = source.data_ptr<uint8_t>();
  uint8_t* out = result.data_ptr<uint8_t>();
  for (int row = 0; row < camera.height; ++row) {
    for (int column = 0; column < camera.width; ++column, out += 4) {
      double x = 0;
      double y = 0;
      const bool valid = distort(distortion, (column + 0.5 - camera.cx) / camera.fx,
                                 (row + 0.5 - camera.cy) / camera.fy, x, y);
      if (!valid && has_mask) continue;
      sample_bilinear(pixels, camera.width, camera.height, camera.fx * x + camera.cx,
                      camera.fy * y + camera.cy, has_mask)
          .store(out);
    }
  }
  return result;
}

}  // namespace tt3d
