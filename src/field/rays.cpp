#include "rays.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>

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

namespace {

/// A view's mask, dilated by the width of a cell of the hull's grid on the picture, so that a cell
/// whose centre projects just outside the silhouette survives. [H,W] uint8.
Tensor dilated_mask(const View& view, int64_t grid_size) {
  const Tensor alpha = (view.rgba.select(2, 3) > 0).to(at::kFloat).unsqueeze(0).unsqueeze(0);
  // A cell at the object's usual distance: half the cell's diagonal, in pixels, and one more.
  const auto position = view.camera.position();
  const double distance =
      std::sqrt(position[0] * position[0] + position[1] * position[1] + position[2] * position[2]);
  const double cell = 2.0 / static_cast<double>(grid_size);
  const double pixels = view.camera.fx * cell / std::max(0.5, distance - 1.0);
  const int64_t radius = 1 + static_cast<int64_t>(std::ceil(pixels * 0.87));
  return at::max_pool2d(alpha, {2 * radius + 1, 2 * radius + 1}, {1, 1}, {radius, radius})
      .squeeze(0)
      .squeeze(0)
      .to(at::kByte)
      .contiguous();
}

}  // namespace

PixelPool make_pixel_pool(const std::vector<View>& views, int64_t occupancy_size) {
  PixelPool pool;
  pool.view_begin.push_back(0);
  for (const View& view : views) {
    pool.targets.push_back(premultiplied(view).contiguous());
    const Tensor inside = dilated_mask(view, occupancy_size).flatten().nonzero().flatten();
    const auto* p = inside.const_data_ptr<int64_t>();
    pool.pixels.insert(pool.pixels.end(), p, p + inside.numel());
    pool.view_begin.push_back(static_cast<int64_t>(pool.pixels.size()));
  }
  if (pool.pixels.empty()) throw InputError("the object is in none of the photographs' masks");
  return pool;
}

Rays random_rays(const std::vector<View>& views, const PixelPool& pool, int64_t count,
                 uint64_t seed, int64_t step) {
  Rays rays = {at::empty({count, 3}), at::empty({count, 3}), at::empty({count, 4})};
  auto* o = rays.origins.mutable_data_ptr<float>();
  auto* d = rays.directions.mutable_data_ptr<float>();
  auto* t = rays.targets.mutable_data_ptr<float>();
  Random random(seed, "field/rays", static_cast<uint64_t>(step));
  const auto pool_size = static_cast<int64_t>(pool.pixels.size());
  for (int64_t r = 0; r < count; ++r) {
    const int64_t i = random.index(pool_size);
    const auto v = std::upper_bound(pool.view_begin.begin(), pool.view_begin.end(), i) -
                   pool.view_begin.begin() - 1;
    const Camera& camera = views[v].camera;
    const int64_t pixel = pool.pixels[i];
    pixel_ray(camera, static_cast<double>(pixel % camera.width) + 0.5,
              static_cast<double>(pixel / camera.width) + 0.5, o + 3 * r, d + 3 * r);
    std::copy_n(pool.targets[v].const_data_ptr<float>() + 4 * pixel, 4, t + 4 * r);
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

namespace {

constexpr double kVisible = 1e-3;  ///< samples behind this transmittance are not shaded

/// Densities of the samples that can be seen, without gradient: in rounds of a few samples a ray,
/// each only for the rays that are still transparent. The rest stay 0.
Tensor visible_densities(const RadianceField& f, const RaySamples& samples, int64_t* evaluated) {
  constexpr int64_t kRound = 16;
  const int64_t rays = samples.ray_begin.size(0) - 1;
  const auto* b = samples.ray_begin.const_data_ptr<int64_t>();
  const auto* steps = samples.steps.const_data_ptr<float>();
  Tensor densities = at::zeros({samples.points.size(0)});
  auto* sigma = densities.mutable_data_ptr<float>();
  std::vector<double> depth(static_cast<size_t>(rays), 0.0);
  const double limit = -std::log(kVisible);
  std::vector<int64_t> chosen;
  for (int64_t round = 0;; ++round) {
    chosen.clear();
    for (int64_t r = 0; r < rays; ++r) {
      if (depth[r] >= limit) continue;
      const int64_t first = b[r] + round * kRound;
      for (int64_t i = first; i < std::min(b[r + 1], first + kRound); ++i) chosen.push_back(i);
    }
    if (chosen.empty()) return densities;
    if (evaluated) *evaluated += static_cast<int64_t>(chosen.size());
    const Tensor index =
        at::from_blob(chosen.data(), {static_cast<int64_t>(chosen.size())}, at::kLong);
    densities.index_copy_(0, index, f.density(samples.points.index_select(0, index)));
    for (int64_t r = 0; r < rays; ++r) {
      const int64_t first = b[r] + round * kRound;
      for (int64_t i = first; i < std::min(b[r + 1], first + kRound); ++i) {
        depth[r] += static_cast<double>(sigma[i] * steps[i]);
      }
    }
  }
}

}  // namespace

Tensor render_rays(const RadianceField& f, const Rays& rays, const Tensor& jitter, double step,
                   bool with_specular, Tensor* specular_loss, int64_t* cost) {
  constexpr double kNear = 0.05;
  RaySamples samples = march_rays(rays.origins, rays.directions, f.occupied, jitter, step, kNear);
  int64_t evaluated = 0;
  {
    // Drop what is hidden before anything is differentiated: most samples inside the object.
    at::NoGradGuard guard;
    const Tensor densities = visible_densities(f, samples, &evaluated);
    const auto [kept, begin] =
        visible_samples(densities, samples.steps, samples.ray_begin, kVisible);
    samples = {samples.points.index_select(0, kept), samples.steps.narrow(0, 0, kept.size(0)),
               begin};
  }
  const int64_t count = samples.points.size(0);
  // A density without gradient costs about a sixth of a sample that is shaded and differentiated.
  if (cost) *cost = count + evaluated / 6;
  const Tensor densities = f.density(samples.points);
  Tensor specular;
  const Tensor directions =
      with_specular ? sample_directions(rays, samples.ray_begin, count) : Tensor();
  const Tensor colors = f.color(samples.points, directions, with_specular, &specular);
  if (specular_loss && specular.defined() && count > 0) *specular_loss = specular.square().mean();
  return composite(densities, colors, samples.steps, samples.ray_begin);
}

Tensor visual_hull(const std::vector<View>& views, int64_t size) {
  std::vector<Tensor> masks;
  for (const View& view : views) masks.push_back(dilated_mask(view, size));
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
      for (int k = 0; k < 4; ++k)
        q[k] = m[4 * k] * p[0] + m[4 * k + 1] * p[1] + m[4 * k + 2] * p[2] + m[4 * k + 3];
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
