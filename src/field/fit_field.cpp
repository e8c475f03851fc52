#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>
#include <torch/csrc/autograd/autograd.h>

#include <cmath>

#include "rays.h"
#include "tt3d/capture.h"
#include "tt3d/field.h"
#include "tt3d/image.h"
#include "tt3d/optimize.h"
#include "tt3d/random_tensor.h"
#include "tt3d/tensor_file.h"

namespace tt3d::field {
namespace {

using at::Tensor;

constexpr int64_t kOccupancyEvery = 16;
constexpr int64_t kAverageSteps = 200;  ///< 0.95^200 is negligible, so earlier steps do not matter
constexpr double kAverageDecay = 0.95;
constexpr int64_t kFewestRays = 256;

std::vector<Tensor> zeros_like_all(const std::vector<Tensor>& tensors) {
  std::vector<Tensor> out;
  out.reserve(tensors.size());
  for (const Tensor& t : tensors)
    out.push_back(at::zeros_like(t, t.options().requires_grad(false)));
  return out;
}

/// The learning rate of a step: linear warm-up, then exponential decay to a tenth.
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

/// Training of a field: its steps, and the state that a checkpoint holds.
class FieldTraining final : public optimize::Optimization {
 public:
  FieldTraining(const capture::Capture& capture, const FieldOptions& options, uint64_t seed)
      : capture_(capture),
        options_(options),
        seed_(seed),
        pool_(make_pixel_pool(capture.train, options.shape.occupancy, options.device)),
        largest_batch_(options.samples_per_step) {}

  void restart() override;
  void visit_state(optimize::StateVisitor& visit) override;
  optimize::StepLoss compute(int64_t step) override;
  void apply(int64_t step, double rate_scale) override;
  void after_step(int64_t step) override;
  bool halve_batch() override;
  /// The mean of the parameters over the last steps.
  [[nodiscard]] RadianceField averaged() const;

 private:
  Tensor loss_of(const Rays& rays, int64_t step, Tensor& mse);
  void average(int64_t step);
  [[nodiscard]] int64_t next_rays() const;

  const capture::Capture& capture_;
  const FieldOptions& options_;
  uint64_t seed_;
  PixelPool pool_;
  int64_t largest_batch_;  ///< samples per step; lowered if memory runs out
  // State.
  RadianceField field_;
  optimize::AdamMoments moments_;
  std::vector<Tensor> average_;
  OccupancyGrid occupancy_;
  int64_t rays_ = 1024;
  // Of the last step.
  std::vector<Tensor> grads_;
  int64_t samples_ = 0;
  double smoothed_mse_ = 0;
};

void FieldTraining::restart() {
  field_ = RadianceField::create(options_.shape, seed_).to(options_.device);
  moments_.restart(field_.parameters());
  average_ = zeros_like_all(field_.parameters());
  occupancy_.hull = visual_hull(capture_.train, options_.shape.occupancy).to(options_.device);
  if (occupancy_.hull.sum().item<int64_t>() == 0) {
    throw InputError(
        "the silhouettes of the photographs have no common volume; check cameras and masks");
  }
  occupancy_.density = occupancy_.hull.to(at::kFloat);
  field_.occupied = occupancy_.hull.clone();
  rays_ = 1024;
  for (const Tensor& p : field_.parameters()) p.requires_grad_(true);
}

void FieldTraining::visit_state(optimize::StateVisitor& visit) {
  visit.tensors("parameter", field_.parameters());
  moments_.visit(visit);
  visit.tensors("average", average_);
  visit.tensor("occupied", field_.occupied);
  visit.tensor("density", occupancy_.density);
  visit.integer("rays", rays_);
}

Tensor FieldTraining::loss_of(const Rays& rays, int64_t step, Tensor& mse) {
  const Random random(seed_, "field/background", static_cast<uint64_t>(step));
  const Tensor noise = uniform_tensor({rays_, 4}, random.key(), options_.device);
  const bool with_specular =
      static_cast<double>(step) >= options_.diffuse_share * static_cast<double>(options_.steps);
  Tensor specular_loss;
  const Tensor rendered = render_rays(field_, rays, noise.select(1, 3).contiguous(),
                                      ray_step(options_), with_specular, &specular_loss, &samples_);
  const Tensor background = noise.narrow(1, 0, 3);
  mse = (image::over_background(rendered, background) -
         image::over_background(rays.targets, background))
            .square()
            .mean();
  Tensor loss = mse + options_.mask_weight *
                          (rendered.select(1, 3) - rays.targets.select(1, 3)).square().mean();
  if (specular_loss.defined()) loss = loss + options_.specular_weight * specular_loss;
  if (options_.tv_weight > 0) {
    loss = loss + options_.tv_weight * total_variation(field_, seed_, step);
  }
  return loss;
}

optimize::StepLoss FieldTraining::compute(int64_t step) {
  Tensor mse;
  const Tensor loss = loss_of(random_rays(pool_, rays_, seed_, step), step, mse);
  grads_ = torch::autograd::grad({loss}, field_.parameters(), {}, false, false,
                                 /*allow_unused=*/true);
  // The only copy to the host in a step.
  const Tensor figures = at::stack({loss.detach(), mse.detach()}).cpu();
  const auto value = figures[0].item<double>(), error = figures[1].item<double>();
  smoothed_mse_ = smoothed_mse_ == 0 ? error : 0.95 * smoothed_mse_ + 0.05 * error;
  return {value, {{"loss", value}, {"psnr", -10 * std::log10(smoothed_mse_)}}};
}

void FieldTraining::apply(int64_t step, double rate_scale) {
  const optimize::Adam adam;
  const double rate = learning_rate(options_, step) * rate_scale;
  const auto parameters = field_.parameters();
  at::NoGradGuard guard;
  for (size_t i = 0; i < parameters.size(); ++i) {
    if (!grads_[i].defined()) continue;
    adam.step(parameters[i], grads_[i].contiguous(), moments_.first[i], moments_.second[i], rate,
              step + 1);
  }
  grads_.clear();  // the next step takes their memory
  average(step);
  rays_ = next_rays();
}

/// Updates the mean of the parameters over the last steps.
void FieldTraining::average(int64_t step) {
  const int64_t from = std::max<int64_t>(0, options_.steps - kAverageSteps);
  if (step < from) return;
  const double decay = step == from ? 0.0 : kAverageDecay;
  const auto parameters = field_.parameters();
  for (size_t i = 0; i < parameters.size(); ++i) {
    average_[i].mul_(decay).add_(parameters[i], 1 - decay);
  }
}

/// The number of rays of the next step, chosen so that it takes about as many samples as the batch
/// allows.
int64_t FieldTraining::next_rays() const {
  const auto rays = static_cast<double>(rays_);
  const double per_ray = std::max(0.25, static_cast<double>(samples_) / rays);
  const double wanted = static_cast<double>(largest_batch_) / per_ray;
  const double limited = std::clamp(wanted, 0.5 * rays, 1.5 * rays);
  return std::clamp(static_cast<int64_t>(limited), kFewestRays, options_.samples_per_step);
}

void FieldTraining::after_step(int64_t step) {
  const int64_t next = step + 1;
  if (next % kOccupancyEvery == 0 && next < options_.steps) {
    occupancy_.refresh(field_, seed_, next);
  }
}

bool FieldTraining::halve_batch() {
  if (rays_ <= kFewestRays) return false;
  rays_ = std::max(kFewestRays, rays_ / 2);
  largest_batch_ /= 2;
  return true;
}

RadianceField FieldTraining::averaged() const {
  at::NoGradGuard guard;
  const auto parameters = field_.parameters();
  for (size_t i = 0; i < parameters.size(); ++i) {
    parameters[i].copy_(average_[i]);
    parameters[i].requires_grad_(false);
  }
  return field_;
}

}  // namespace

double ray_step(const FieldOptions& options) {
  return 2 * std::sqrt(3.0) / static_cast<double>(options.ray_steps);
}

RadianceField fit_field(const capture::Capture& capture, const FieldOptions& options, uint64_t seed,
                        const std::filesystem::path& checkpoint, Progress& progress) {
  if (!capture.has_masks) {
    throw InputError(
        "the capture has no masks; make them with 'tt3d photos', or add an alpha channel or mask "
        "files");
  }
  FieldTraining training(capture, options, seed);
  optimize::run_loop(training,
                     {"field", options.steps, options.checkpoint_every, checkpoint,
                      "lower field.rate (now " + std::to_string(options.rate) + ")",
                      "lower field.samples_per_step"},
                     progress);
  return training.averaged();
}

}  // namespace tt3d::field
