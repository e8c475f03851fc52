#include <ATen/ATen.h>
#include <torch/csrc/autograd/autograd.h>

#include <cmath>

#include "rays.h"
#include "tt3d/field.h"
#include "tt3d/random_tensor.h"
#include "tt3d/tensor_file.h"

namespace tt3d {
namespace {

using at::Tensor;

constexpr int64_t kOccupancyEvery = 16;
constexpr int64_t kAverageSteps = 200;  ///< 0.95^200 is nothing: earlier averaging is invisible
constexpr double kAverageDecay = 0.95;

/// Everything that changes while training; saved and restored whole.
struct TrainingState {
  RadianceField field;
  std::vector<Tensor> moment1, moment2, average;
  field::OccupancyGrid occupancy;
  int64_t step = 0;
  int64_t rays = 1024;
  Recovery recovery;
};

std::vector<Tensor> zeros_like_all(const std::vector<Tensor>& tensors) {
  std::vector<Tensor> out;
  for (const Tensor& t : tensors)
    out.push_back(at::zeros_like(t, t.options().requires_grad(false)));
  return out;
}

void require_gradients(const RadianceField& f) {
  for (const Tensor& p : f.parameters()) p.requires_grad_(true);
}

TrainingState fresh_state(const Capture& capture, const FieldOptions& options, uint64_t seed) {
  TrainingState s;
  s.field = RadianceField::create(options.shape, seed).to(options.device);
  s.moment1 = zeros_like_all(s.field.parameters());
  s.moment2 = zeros_like_all(s.field.parameters());
  s.average = zeros_like_all(s.field.parameters());
  s.occupancy.hull = field::visual_hull(capture.train, options.shape.occupancy).to(options.device);
  if (s.occupancy.hull.sum().item<int64_t>() == 0) {
    throw InputError("the silhouettes of the photographs share no volume: wrong cameras or masks");
  }
  s.occupancy.density = s.occupancy.hull.to(at::kFloat);
  s.field.occupied = s.occupancy.hull.clone();
  require_gradients(s.field);
  return s;
}

void save_state(const TrainingState& s, const std::filesystem::path& path) {
  std::vector<std::pair<std::string, Tensor>> tensors;
  const auto add_all = [&](const std::string& prefix, const std::vector<Tensor>& list) {
    for (size_t i = 0; i < list.size(); ++i) {
      tensors.emplace_back(prefix + std::to_string(i), list[i].detach());
    }
  };
  add_all("parameter.", s.field.parameters());
  add_all("moment1.", s.moment1);
  add_all("moment2.", s.moment2);
  add_all("average.", s.average);
  tensors.emplace_back("occupied", s.field.occupied);
  tensors.emplace_back("density", s.occupancy.density);
  tensors.emplace_back("counters",
                       at::tensor({s.step, s.rays, int64_t{s.recovery.rollbacks}}, at::kLong));
  tensors.emplace_back("rate_scale",
                       at::tensor({static_cast<float>(s.recovery.rate_scale)}, at::kFloat));
  save_tensors(path, tensors, {{"format", "tt3d field training"}});
}

void load_state(const std::filesystem::path& path, TrainingState& s) {
  const TensorFile file = load_tensors(path);
  at::NoGradGuard guard;
  const auto copy_all = [&](const std::string& prefix, const std::vector<Tensor>& list) {
    for (size_t i = 0; i < list.size(); ++i) {
      list[i].copy_(file.get(prefix + std::to_string(i), list[i].sizes(), at::kFloat));
    }
  };
  copy_all("parameter.", s.field.parameters());
  copy_all("moment1.", s.moment1);
  copy_all("moment2.", s.moment2);
  copy_all("average.", s.average);
  s.field.occupied.copy_(file.get("occupied", s.field.occupied.sizes(), at::kByte));
  s.occupancy.density.copy_(file.get("density", s.occupancy.density.sizes(), at::kFloat));
  const Tensor counters = file.get("counters", {3}, at::kLong);
  s.step = counters[0].item<int64_t>();
  s.rays = counters[1].item<int64_t>();
  s.recovery.rollbacks = counters[2].item<int>();
  s.recovery.rate_scale = file.get("rate_scale", {1}, at::kFloat).item<double>();
}

/// Linear warm-up, then exponential decay to a tenth.
double learning_rate(const FieldOptions& options, int64_t step) {
  const auto warmup =
      static_cast<double>(std::min(options.warmup, std::max<int64_t>(1, options.steps / 10)));
  const auto t = static_cast<double>(step);
  if (t < warmup) return options.rate * (t + 1) / warmup;
  return options.rate * std::pow(0.1, (t - warmup) / (static_cast<double>(options.steps) - warmup));
}

/// Total variation at random points: squared differences of the encoding to a neighbour a small
/// step away, in every level at once (the official code samples grid cells).
Tensor total_variation(const RadianceField& f, uint64_t seed, int64_t step) {
  constexpr int64_t kPoints = 1024;
  constexpr double kOffset = 1.0 / 128;
  const Random random(seed, "field/tv", static_cast<uint64_t>(step));
  const Tensor points = uniform_tensor({kPoints, 3}, -1, 1, random.key(), f.device());
  const auto variation = [&](const Tensor& grid, const HashGridShape& shape) {
    return (hash_encode(points, grid, shape) - hash_encode(points + kOffset, grid, shape))
        .square()
        .sum();
  };
  return variation(f.geometry_grid, f.shape.geometry) +
         variation(f.appearance.grid, f.shape.appearance);
}

struct StepResult {
  double loss = 0;
  double mse = 0;
  int64_t samples = 0;
};

/// Draws rays, renders, differentiates. Gradients are left in `grads`.
StepResult compute_gradients(const field::PixelPool& pool, const FieldOptions& options,
                             uint64_t seed, const TrainingState& s, std::vector<Tensor>& grads) {
  const field::Rays rays = field::random_rays(pool, s.rays, seed, s.step);
  const Random random(seed, "field/background", static_cast<uint64_t>(s.step));
  const Tensor noise = uniform_tensor({s.rays, 4}, random.key(), options.device);
  const bool with_specular =
      static_cast<double>(s.step) >= options.diffuse_share * static_cast<double>(options.steps);
  StepResult result;
  Tensor specular_loss;
  const Tensor rendered =
      field::render_rays(s.field, rays, noise.select(1, 3).contiguous(), ray_step(options),
                         with_specular, &specular_loss, &result.samples);
  const Tensor background = noise.narrow(1, 0, 3);
  const Tensor mse =
      (over_background(rendered, background) - over_background(rays.targets, background))
          .square()
          .mean();
  Tensor loss = mse + options.mask_weight *
                          (rendered.select(1, 3) - rays.targets.select(1, 3)).square().mean();
  if (specular_loss.defined()) loss = loss + options.specular_weight * specular_loss;
  if (options.tv_weight > 0)
    loss = loss + options.tv_weight * total_variation(s.field, seed, s.step);
  grads = torch::autograd::grad({loss}, s.field.parameters(), {}, false, false,
                                /*allow_unused=*/true);
  // The step's one way back to the host.
  const Tensor figures = at::stack({loss.detach(), mse.detach()}).cpu();
  result.loss = figures[0].item<double>();
  result.mse = figures[1].item<double>();
  return result;
}

void apply_gradients(const FieldOptions& options, const std::vector<Tensor>& grads,
                     TrainingState& s) {
  const Adam adam;
  const double rate = learning_rate(options, s.step) * s.recovery.rate_scale;
  const auto parameters = s.field.parameters();
  at::NoGradGuard guard;
  for (size_t i = 0; i < parameters.size(); ++i) {
    if (!grads[i].defined()) continue;
    adam.step(parameters[i], grads[i].contiguous(), s.moment1[i], s.moment2[i], rate, s.step + 1);
  }
  const int64_t averaging_from = std::max<int64_t>(0, options.steps - kAverageSteps);
  if (s.step < averaging_from) return;
  const double decay = s.step == averaging_from ? 0.0 : kAverageDecay;
  for (size_t i = 0; i < parameters.size(); ++i) {
    s.average[i].mul_(decay).add_(parameters[i], 1 - decay);
  }
}

/// Rays of the next step, so that it takes about options.samples_per_step samples.
int64_t next_rays(const FieldOptions& options, int64_t rays, int64_t samples) {
  const double per_ray = std::max(0.25, static_cast<double>(samples) / static_cast<double>(rays));
  const double wanted = static_cast<double>(options.samples_per_step) / per_ray;
  const double limited =
      std::clamp(wanted, 0.5 * static_cast<double>(rays), 1.5 * static_cast<double>(rays));
  return std::clamp(static_cast<int64_t>(limited), int64_t{256}, options.samples_per_step);
}

/// After a step that was not finite: back to the last good state at half the rate.
void roll_back(const std::filesystem::path& checkpoint, const Capture& capture,
               const FieldOptions& options, uint64_t seed, TrainingState& s, Progress& progress) {
  const Recovery recovery = s.recovery.after_divergence(
      "field training", s.step, "lower field.rate (now " + std::to_string(options.rate) + ")",
      progress);
  s = fresh_state(capture, options, seed);
  if (std::filesystem::exists(checkpoint)) load_state(checkpoint, s);
  s.recovery = recovery;
}

RadianceField averaged(const TrainingState& s) {
  at::NoGradGuard guard;
  const auto parameters = s.field.parameters();
  for (size_t i = 0; i < parameters.size(); ++i) {
    parameters[i].copy_(s.average[i]);
    parameters[i].requires_grad_(false);
  }
  return s.field;
}

}  // namespace

double ray_step(const FieldOptions& options) {
  return 2 * std::sqrt(3.0) / static_cast<double>(options.ray_steps);
}

RadianceField fit_field(const Capture& capture, const FieldOptions& options, uint64_t seed,
                        const std::filesystem::path& checkpoint, Progress& progress) {
  if (!capture.has_masks) {
    throw InputError(
        "the capture has no masks: give the photographs an alpha channel, or mask_path entries");
  }
  const field::PixelPool pool =
      field::make_pixel_pool(capture.train, options.shape.occupancy, options.device);
  TrainingState s = fresh_state(capture, options, seed);
  if (std::filesystem::exists(checkpoint)) load_state(checkpoint, s);
  progress.begin("field", options.steps, s.step);
  double smoothed = 0;
  while (s.step < options.steps) {
    if (s.step % kOccupancyEvery == 0 && s.step > 0) s.occupancy.refresh(s.field, seed, s.step);
    std::vector<Tensor> grads;
    const StepResult result = compute_gradients(pool, options, seed, s, grads);
    if (!std::isfinite(result.loss)) {
      roll_back(checkpoint, capture, options, seed, s, progress);
      continue;
    }
    apply_gradients(options, grads, s);
    s.rays = next_rays(options, s.rays, result.samples);
    ++s.step;
    smoothed = smoothed == 0 ? result.mse : 0.95 * smoothed + 0.05 * result.mse;
    progress.update(s.step, {{"loss", result.loss}, {"psnr", -10 * std::log10(smoothed)}});
    if (s.step % options.checkpoint_every == 0) save_state(s, checkpoint);
    progress.check();
  }
  progress.end();
  return averaged(s);
}

}  // namespace tt3d
