#pragma once

#include <ATen/ATen.h>

#include <array>
#include <cmath>

#include "tt3d/capture.h"
#include "tt3d/scene.h"

namespace tt3d::testing {

/// A capture in memory: a ball of radius 0.6 whose colour encodes the position on it (rgb = 0.5 +
/// 0.5 * unit position), in `views` photographs of size x size from different directions. Every
/// fourth view is a test view. The pictures are exact: ray-sphere intersection, four samples per
/// pixel.
inline capture::Capture ball_capture(int views, int size) {
  constexpr double kRadius = 0.6;
  const scene::ViewFrame frame = {{0, 0, 0}, 1, 3.2, 40};
  capture::Capture capture;
  capture.has_masks = true;
  const auto cameras =
      scene::sample_views(scene::ViewDistribution::kSphere, 11, 0, views, size, frame);
  for (int i = 0; i < views; ++i) {
    capture::View view;
    view.name = "ball_" + std::to_string(i);
    view.camera = cameras[static_cast<size_t>(i)].camera;
    view.rgba = at::zeros({size, size, 4}, at::kByte);
    auto* out = view.rgba.mutable_data_ptr<uint8_t>();
    const auto& m = view.camera.camera_to_world;
    for (int y = 0; y < size; ++y) {
      for (int x = 0; x < size; ++x, out += 4) {
        double sum[3] = {}, hits = 0;
        for (int s = 0; s < 4; ++s) {
          const double px = x + 0.25 + 0.5 * (s % 2), py = y + 0.25 + 0.5 * (s / 2);
          const double local[3] = {(px - view.camera.cx) / view.camera.fx,
                                   -(py - view.camera.cy) / view.camera.fy, -1};
          double d[3], o[3], dd = 0, od = 0, oo = 0;
          for (int k = 0; k < 3; ++k) {
            d[k] = m[4 * k] * local[0] + m[4 * k + 1] * local[1] + m[4 * k + 2] * local[2];
            o[k] = m[4 * k + 3];
            dd += d[k] * d[k];
            od += o[k] * d[k];
            oo += o[k] * o[k];
          }
          const double root = od * od - dd * (oo - kRadius * kRadius);
          if (root < 0) continue;
          const double t = (-od - std::sqrt(root)) / dd;
          ++hits;
          for (int k = 0; k < 3; ++k) sum[k] += 0.5 + 0.5 * (o[k] + t * d[k]) / kRadius;
        }
        if (hits == 0) continue;
        for (int k = 0; k < 3; ++k) out[k] = static_cast<uint8_t>(std::lround(255 * sum[k] / hits));
        out[3] = static_cast<uint8_t>(std::lround(255 * hits / 4));
      }
    }
    (i % 4 == 3 ? capture.test : capture.train).push_back(std::move(view));
  }
  return capture;
}

}  // namespace tt3d::testing
