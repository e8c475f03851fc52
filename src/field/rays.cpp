#include "rays.h"

#include "tt3d/image.h"

#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "march_math.h"
#include "rays_math.h"
#include "tt3d/capture.h"
#include "tt3d/device.h"
#include "tt3d/scene.h"

namespace tt3d::field {

using at::Tensor;

namespace {

/// A view's mask, dilated by the projected width of a cell of the hull's grid. A cell whose centre
/// projects just outside the silhouette is thus kept. [H,W] uint8.
Tensor dilated_mask(const capture::View& view, int64_t grid_size) {
  const Tensor alpha = (view.rgba.select(2, 3) > 0).to(at::kFloat).unsqueeze(0).unsqueeze(0);
  // Radius in pixels: half the diagonal of a cell at the object's usual distance, plus one.
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

namespace {

/// A camera as a kernel argument.
std::array<double, kCameraNumbers> camera_numbers(const scene::Camera& camera,
                                                  int64_t first_pixel) {
  std::array<double, kCameraNumbers> numbers{};
  std::copy_n(camera.camera_to_world.begin(), 12, numbers.begin());
  const double rest[] = {camera.fx,
                         camera.fy,
                         camera.cx,
                         camera.cy,
                         static_cast<double>(camera.width),
                         static_cast<double>(first_pixel)};
  std::copy_n(rest, 6, numbers.begin() + 12);
  return numbers;
}

Rays empty_rays(int64_t count, at::Device device) {
  const auto options = at::TensorOptions().dtype(at::kFloat).device(device);
  return {at::empty({count, 3}, options), at::empty({count, 3}, options), Tensor()};
}

}  // namespace

PixelPool make_pixel_pool(const std::vector<capture::View>& views, int64_t occupancy_size,
                          at::Device device) {
  std::vector<Tensor> pictures, pixels;
  std::vector<double> cameras;
  std::vector<int64_t> view_begin = {0};
  int64_t first_pixel = 0;
  for (const capture::View& view : views) {
    pictures.push_back(view.rgba.reshape({-1, 4}));
    pixels.push_back(dilated_mask(view, occupancy_size).flatten().nonzero().flatten().to(at::kInt));
    const auto numbers = camera_numbers(view.camera, first_pixel);
    cameras.insert(cameras.end(), numbers.begin(), numbers.end());
    view_begin.push_back(view_begin.back() + pixels.back().numel());
    first_pixel += pictures.back().size(0);
  }
  if (view_begin.back() == 0) throw InputError("the object is in none of the photographs' masks");
  PixelPool pool;
  pool.pictures = at::cat(pictures).to(device);
  pool.pixels = at::cat(pixels).to(device);
  pool.cameras = at::tensor(cameras, at::kDouble).view({-1, kCameraNumbers}).to(device);
  pool.view_begin = at::tensor(view_begin, at::kLong).to(device);
  return pool;
}

Rays random_rays(const PixelPool& pool, int64_t count, uint64_t seed, int64_t step) {
  Rays rays = empty_rays(count, pool.pictures.device());
  rays.targets = at::empty({count, 4}, rays.origins.options());
  const Random random(seed, "field/rays", static_cast<uint64_t>(step));
  const DrawRay body = {random.key(),
                        pool.pixels.const_data_ptr<int32_t>(),
                        pool.view_begin.const_data_ptr<int64_t>(),
                        pool.cameras.size(0),
                        pool.cameras.const_data_ptr<double>(),
                        pool.pictures.const_data_ptr<uint8_t>(),
                        rays.origins.mutable_data_ptr<float>(),
                        rays.directions.mutable_data_ptr<float>(),
                        rays.targets.mutable_data_ptr<float>()};
  for_each_index_on(pool.pictures, count, body);
  return rays;
}

Rays row_rays(const scene::Camera& camera, int64_t row_begin, int64_t row_end, at::Device device) {
  const int64_t count = (row_end - row_begin) * camera.width;
  Rays rays = empty_rays(count, device);
  RowRay body = {{},
                 row_begin,
                 rays.origins.mutable_data_ptr<float>(),
                 rays.directions.mutable_data_ptr<float>()};
  const auto numbers = camera_numbers(camera, 0);
  std::copy(numbers.begin(), numbers.end(), body.camera);
  for_each_index_on(rays.origins, count, body);
  return rays;
}

namespace {

/// Directions of the samples, copied from their rays: [S,3].
Tensor sample_directions(const Rays& rays, const Tensor& ray_begin, int64_t samples) {
  Tensor out = at::empty({samples, 3}, rays.directions.options());
  const RepeatDirection body = {rays.directions.const_data_ptr<float>(),
                                ray_begin.const_data_ptr<int64_t>(), out.mutable_data_ptr<float>()};
  for_each_index_on(out, ray_begin.size(0) - 1, body);
  return out;
}

constexpr double kVisible = 1e-3;  ///< samples behind this transmittance are not shaded

/// Densities of the samples that can be seen, without gradient. Each round evaluates a few samples
/// per ray, only for rays that are still transparent. The other samples keep density 0.
Tensor visible_densities(const RadianceField& f, const RaySamples& samples, int64_t* evaluated) {
  constexpr int64_t kRound = 16;
  const int64_t rays = samples.ray_begin.size(0) - 1;
  const auto count_options = samples.ray_begin.options();
  Tensor densities = at::zeros({samples.points.size(0)}, samples.points.options());
  Tensor depth = at::zeros({rays}, samples.points.options().dtype(at::kDouble));
  auto* depths = depth.mutable_data_ptr<double>();
  for (int64_t round = 0;; ++round) {
    const RoundRange range = {samples.ray_begin.const_data_ptr<int64_t>(), depths,
                              -std::log(kVisible), round * kRound, kRound};
    Tensor begin = at::zeros({rays + 1}, count_options);
    for_each_index_on(depth, rays, CountRound{range, begin.mutable_data_ptr<int64_t>()});
    const int64_t total = counts_to_begins(begin);
    if (total == 0) return densities;
    if (evaluated) *evaluated += total;
    const auto* chosen_begin = begin.const_data_ptr<int64_t>();
    Tensor chosen = at::empty({total}, count_options);
    for_each_index_on(depth, rays,
                      WriteRound{range, chosen_begin, chosen.mutable_data_ptr<int64_t>()});
    densities.index_copy_(0, chosen, f.density(samples.points.index_select(0, chosen)));
    for_each_index_on(depth, rays,
                      AddRound{range, chosen_begin, densities.const_data_ptr<float>(),
                               samples.steps.const_data_ptr<float>(), depths});
  }
}

}  // namespace

Tensor render_rays(const RadianceField& f, const Rays& rays, const Tensor& jitter, double step,
                   bool with_specular, Tensor* specular_loss, int64_t* cost) {
  constexpr double kNear = 0.05;
  RaySamples samples = march_rays(rays.origins, rays.directions, f.occupied, jitter, step, kNear);
  int64_t evaluated = 0;
  {
    // Drop hidden samples before the differentiable part: most samples inside the object are
    // hidden.
    at::NoGradGuard guard;
    const Tensor densities = visible_densities(f, samples, &evaluated);
    const auto [kept, begin] =
        visible_samples(densities, samples.steps, samples.ray_begin, kVisible);
    samples = {samples.points.index_select(0, kept), samples.steps.narrow(0, 0, kept.size(0)),
               begin};
  }
  const int64_t count = samples.points.size(0);
  // A density without gradient costs about a sixth of a sample with colour and gradients.
  if (cost) *cost = count + evaluated / 6;
  const Tensor densities = f.density(samples.points);
  Tensor specular;
  const Tensor directions =
      with_specular ? sample_directions(rays, samples.ray_begin, count) : Tensor();
  const Tensor colors = f.color(samples.points, directions, with_specular, &specular);
  if (specular_loss && specular.defined() && count > 0) *specular_loss = specular.square().mean();
  return composite(densities, colors, samples.steps, samples.ray_begin);
}

Tensor visual_hull(const std::vector<capture::View>& views, int64_t size) {
  std::vector<Tensor> masks;
  masks.reserve(views.size());
  for (const capture::View& view : views) masks.push_back(dilated_mask(view, size));
  std::vector<std::array<double, 16>> world_to_camera;
  world_to_camera.reserve(views.size());
  for (const capture::View& view : views)
    world_to_camera.push_back(scene::world_to_clip(view.camera, 0.01, 100));
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
      for (size_t k = 0; k < 4; ++k)
        q[k] = m[4 * k] * p[0] + m[4 * k + 1] * p[1] + m[4 * k + 2] * p[2] + m[4 * k + 3];
      if (q[3] <= 0) continue;
      const scene::Camera& camera = views[v].camera;
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
  Tensor points = at::empty({cells.size(0), 3}, density.options());
  const Random random(seed, "field/occupancy", static_cast<uint64_t>(step));
  for_each_index_on(points, cells.size(0),
                    CellPoint{random.key(), cells.const_data_ptr<int64_t>(), size,
                              points.mutable_data_ptr<float>()});
  const Tensor fresh = f.density(points);
  Tensor flat = density.view({-1});
  const Tensor updated = at::maximum(flat.index_select(0, cells) * 0.95, fresh);
  flat.index_copy_(0, cells, updated);
  f.occupied = (density > updated.mean().clamp_max(10)).to(at::kByte);
}

}  // namespace tt3d::field
