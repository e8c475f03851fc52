#include "rays.h"

#include <ATen/ATen.h>

#include <cmath>
#include <numeric>

#include "tt3d/device.h"

namespace tt3d::field {

using at::Tensor;

void pixel_ray(const Camera& camera, double column, double row, float origin[3],
               float direction[3]) {
  const double local[3] = {(column - camera.cx) / camera.fx, -(row - camera.cy) / camera.fy, -1.0};
  const auto& m = camera.camera_to_world;
  double world[3], norm = 0;
  for (int k = 0; k < 3; ++k) {
    world[k] = m[4 * k] * local[0] + m[4 * k + 1] * local[1] + m[4 * k + 2] * local[2];
    norm += world[k] * world[k];
  }
  for (int k = 0; k < 3; ++k) {
    origin[k] = static_cast<float>(m[4 * k + 3]);
    direction[k] = static_cast<float>(world[k] / std::sqrt(norm));
  }
}

Rays random_rays(const std::vector<View>& views, const std::vector<Tensor>& targets, int64_t count,
                 uint64_t seed, int64_t step) {
  Rays rays = {at::empty({count, 3}), at::empty({count, 3}), at::empty({count, 4})};
  auto* o = rays.origins.mutable_data_ptr<float>();
  auto* d = rays.directions.mutable_data_ptr<float>();
  auto* t = rays.targets.mutable_data_ptr<float>();
  Random random(seed, "field/rays", static_cast<uint64_t>(step));
  for (int64_t r = 0; r < count; ++r) {
    const int64_t v = random.index(static_cast<int64_t>(views.size()));
    const Camera& camera = views[v].camera;
    const int64_t x = random.index(camera.width), y = random.index(camera.height);
    pixel_ray(camera, static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5, o + 3 * r,
              d + 3 * r);
    const float* target = targets[v].const_data_ptr<float>() + (y * camera.width + x) * 4;
    std::copy_n(target, 4, t + 4 * r);
  }
  return rays;
}

Rays row_rays(const Camera& camera, int64_t row_begin, int64_t row_end) {
  const int64_t count = (row_end - row_begin) * camera.width;
  Rays rays = {at::empty({count, 3}), at::empty({count, 3}), Tensor()};
  auto* o = rays.origins.mutable_data_ptr<float>();
  auto* d = rays.directions.mutable_data_ptr<float>();
  for_each_index(count, [&](int64_t i) {
    pixel_ray(camera, static_cast<double>(i % camera.width) + 0.5,
              static_cast<double>(row_begin + i / camera.width) + 0.5, o + 3 * i, d + 3 * i);
  });
  return rays;
}

namespace {

/// Directions of the samples, repeated from their rays: [S,3].
Tensor sample_directions(const Rays& rays, const Tensor& ray_begin, int64_t samples) {
  Tensor out = at::empty({samples, 3});
  auto* p = out.mutable_data_ptr<float>();
  const auto* d = rays.directions.const_data_ptr<float>();
  const auto* b = ray_begin.const_data_ptr<int64_t>();
  for_each_index(ray_begin.size(0) - 1, [&](int64_t r) {
    for (int64_t i = b[r]; i < b[r + 1]; ++i) std::copy_n(d + 3 * r, 3, p + 3 * i);
  });
  return out;
}

}  // namespace

Tensor render_rays(const RadianceField& f, const Rays& rays, const Tensor& jitter, double step,
                   bool with_specular, Tensor* specular_loss, int64_t* sample_count) {
  constexpr double kNear = 0.05;
  constexpr double kVisible = 1e-3;
  RaySamples samples =
      march_rays(rays.origins, rays.directions, f.occupied, jitter, step, kNear);
  {
    // Drop what is hidden before anything is differentiated: most samples inside the object.
    at::NoGradGuard guard;
    const Tensor densities = f.density(samples.points);
    const auto [kept, begin] =
        visible_samples(densities, samples.steps, samples.ray_begin, kVisible);
    samples = {samples.points.index_select(0, kept), samples.steps.narrow(0, 0, kept.size(0)),
               begin};
  }
  const int64_t count = samples.points.size(0);
  if (sample_count) *sample_count = count;
  const Tensor densities = f.density(samples.points);
  Tensor specular;
  const Tensor directions =
      with_specular ? sample_directions(rays, samples.ray_begin, count) : Tensor();
  const Tensor colors = f.color(samples.points, directions, with_specular, &specular);
  if (specular_loss && specular.defined() && count > 0) *specular_loss = specular.square().mean();
  return composite(densities, colors, samples.steps, samples.ray_begin);
}

Tensor visual_hull(const std::vector<View>& views, int64_t size) {
  // Alpha dilated by a few pixels, so that a cell whose centre projects just outside survives.
  std::vector<Tensor> masks;
  for (const View& view : views) {
    const Tensor alpha = (view.rgba.select(2, 3) > 0).to(at::kFloat).unsqueeze(0).unsqueeze(0);
    const double pixels_a_cell = view.camera.fx * 2.0 / static_cast<double>(size) / 2.0;
    const int64_t radius = 1 + static_cast<int64_t>(std::ceil(pixels_a_cell * 0.5));
    masks.push_back(at::max_pool2d(alpha, {2 * radius + 1, 2 * radius + 1}, {1, 1},
                                   {radius, radius})
                        .squeeze()
                        .to(at::kByte)
                        .contiguous());
  }
  std::vector<std::array<double, 16>> world_to_camera;
  for (const View& view : views) world_to_camera.push_back(world_to_clip(view.camera, 0.01, 100));
  Tensor hull = at::zeros({size, size, size}, at::kByte);
  auto* out = hull.mutable_data_ptr<uint8_t>();
  for_each_index(size * size * size, [&](int64_t i) {
    const auto coordinate = [&](int64_t c) {
      return (2.0 * static_cast<double>(c) + 1.0) / static_cast<double>(size) - 1.0;
    };
    const double p[3] = {coordinate(i % size), coordinate(i / size % size),
                         coordinate(i / size / size)};
    bool seen = false;
    for (size_t v = 0; v < views.size(); ++v) {
      const auto& m = world_to_camera[v];
      double q[4];
      for (int k = 0; k < 4; ++k) q[k] = m[4 * k] * p[0] + m[4 * k + 1] * p[1] + m[4 * k + 2] * p[2] + m[4 * k + 3];
      if (q[3] <= 0) continue;
      const Camera& camera = views[v].camera;
      const double x = (q[0] / q[3] + 1) * 0.5 * camera.width;
      const double y = (1 - q[1] / q[3]) * 0.5 * camera.height;
      if (x < 0 || y < 0 || x >= camera.width || y >= camera.height) continue;
      const auto pixel = static_cast<int64_t>(y) * camera.width + static_cast<int64_t>(x);
      if (masks[v].const_data_ptr<uint8_t>()[pixel] == 0) return;
      seen = true;
    }
    out[i] = seen ? 1 : 0;
  });
  return hull;
}

void OccupancyGrid::refresh(RadianceField& f, uint64_t seed, int64_t step) {
  at::NoGradGuard guard;
  const int64_t size = hull.size(0);
  const Tensor cells = hull.flatten().nonzero().flatten();
  Tensor points = at::empty({cells.size(0), 3});
  auto* p = points.mutable_data_ptr<float>();
  const auto* c = cells.const_data_ptr<int64_t>();
  Random random(seed, "field/occupancy", static_cast<uint64_t>(step));
  const float width = 2.0F / static_cast<float>(size);
  for (int64_t i = 0; i < cells.size(0); ++i) {
    const int64_t coordinate[3] = {c[i] % size, c[i] / size % size, c[i] / size / size};
    for (int k = 0; k < 3; ++k) {
      p[3 * i + k] = -1 + width * (static_cast<float>(coordinate[k]) + random.uniform());
    }
  }
  const Tensor fresh = f.density(points);
  Tensor flat = density.view({-1});
  const Tensor updated = at::maximum(flat.index_select(0, cells) * 0.95, fresh);
  flat.index_copy_(0, cells, updated);
  const double threshold = std::min(updated.mean().item<double>(), 10.0);
  f.occupied = (density > threshold).to(at::kByte);
}

}  // namespace tt3d::field
