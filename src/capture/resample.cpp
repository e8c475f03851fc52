#include "resample.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>

#include "tt3d/image.h"
#include "tt3d/pixel_sum.h"
#include "tt3d/scene.h"

namespace tt3d::capture {
namespace {

/// Bilinear sample at pixel coordinates (centres at .5). Outside the image: transparent if
/// `has_mask`, else the nearest edge pixel.
image::PixelSum sample_bilinear(const uint8_t* image, int width, int height, double u, double v,
                                bool has_mask) {
  const double x = std::clamp(u - 0.5, -2.0, width + 1.0);
  const double y = std::clamp(v - 0.5, -2.0, height + 1.0);
  const int x0 = static_cast<int>(std::floor(x));
  const int y0 = static_cast<int>(std::floor(y));
  const auto fx = static_cast<float>(x - x0);
  const auto fy = static_cast<float>(y - y0);
  image::PixelSum sum;
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

void limit_size(View& view, int max_size) {
  scene::Camera& camera = view.camera;
  const int longer = std::max(camera.width, camera.height);
  if (max_size <= 0 || longer <= max_size) return;
  const auto scaled = [&](int side) {
    return std::max(1,
                    static_cast<int>(std::lround(side * static_cast<double>(max_size) / longer)));
  };
  const int width = scaled(camera.width);
  const int height = scaled(camera.height);
  view.rgba = image::downscale(view.rgba, width, height);
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

at::Tensor undistort(const at::Tensor& rgba, const scene::Camera& camera,
                     const Distortion& distortion, bool has_mask) {
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

}  // namespace tt3d::capture
