#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>
#include <torch/csrc/autograd/autograd.h>

#include <cmath>

#include "tt3d/appearance.h"
#include "tt3d/optimize.h"
#include "tt3d/raster.h"
#include "tt3d/surface.h"

namespace tt3d::object {

using at::Tensor;

raster::SurfacePoints sample_surface(const scene::TriMesh& mesh, int64_t count, Random random) {
  at::NoGradGuard guard;
  const auto device = mesh.vertices.device();
  const Tensor corners = mesh.vertices.cpu()
                             .index_select(0, mesh.faces.cpu().flatten().to(at::kLong))
                             .view({-1, 3, 3})
                             .to(at::kDouble);
  const Tensor a = corners.select(1, 0);
  const Tensor areas =
      at::cross(corners.select(1, 1) - a, corners.select(1, 2) - a, 1).norm(2, {1});
  const Tensor up_to = areas.cumsum(0);
  const double all = up_to[-1].item<double>();
  std::vector<double> places;
  std::vector<float> weights;
  for (int64_t i = 0; i < count; ++i) {
    places.push_back(random.uniform() * all);
    // Uniform over a triangle: fold the upper half of the unit square back (Osada et al. 2002).
    double u = random.uniform(), v = random.uniform();
    if (u + v > 1) u = 1 - u, v = 1 - v;
    for (const double w : {u, v}) weights.push_back(static_cast<float>(w));
  }
  const Tensor face =
      at::searchsorted(up_to, at::tensor(places, at::kDouble)).clamp_max(areas.size(0) - 1);
  const Tensor uv = at::tensor(weights).view({-1, 2});
  const Tensor rast =
      at::cat({uv, at::zeros({count, 1}), (face + 1).to(at::kFloat).unsqueeze(1)}, 1);
  const Tensor share = at::cat({uv, 1 - uv.sum(1, true)}, 1).unsqueeze(2);
  const Tensor position = (corners.index_select(0, face).to(at::kFloat) * share).sum(1);
  return {position.to(device), rast.to(device)};
}

namespace {

/// Fits a grid and MLP to the colours of another appearance.
class AppearanceFit final : public optimize::Optimization {
 public:
  AppearanceFit(const Appearance& target, const scene::TriMesh& mesh,
                const field::FieldShape& shape, uint64_t seed, int64_t steps)
      : target_(target), mesh_(mesh), shape_(shape), seed_(seed), steps_(steps) {}

  void restart() override {
    fitted_ = std::make_unique<GridMlpAppearance>(
        field::RadianceField::create(shape_, seed_).appearance.to(mesh_.vertices.device()));
    moments_.restart(fitted_->parameters());
    for (const Tensor& p : fitted_->parameters()) p.requires_grad_(true);
  }

  void visit_state(optimize::StateVisitor& visit) override {
    visit.tensors("parameter", fitted_->parameters());
    moments_.visit(visit);
  }

  optimize::StepLoss compute(int64_t step) override {
    const raster::SurfacePoints points =
        sample_surface(mesh_, points_, Random(seed_, "attack/look", static_cast<uint64_t>(step)));
    Tensor wanted;
    {
      at::NoGradGuard guard;
      wanted = target_.color(points);
    }
    const Tensor loss = (fitted_->color(points) - wanted).square().mean();
    grads_ = torch::autograd::grad({loss}, fitted_->parameters());
    return {loss.item<double>(), {}};
  }

  void apply(int64_t step, double rate_scale) override {
    constexpr double kRate = 1e-2, kFinal = 0.1;
    const auto parameters = fitted_->parameters();
    at::NoGradGuard guard;
    const double rate = rate_scale * kRate *
                        std::pow(kFinal, static_cast<double>(step) / static_cast<double>(steps_));
    for (size_t i = 0; i < parameters.size(); ++i) {
      optimize::Adam{}.step(parameters[i], grads_[i].contiguous(), moments_.first[i],
                            moments_.second[i], rate, step + 1);
    }
    grads_.clear();  // the next step takes their memory
  }

  bool halve_batch() override {
    constexpr int64_t kFewest = 256;
    if (points_ <= kFewest) return false;
    points_ /= 2;
    return true;
  }

  [[nodiscard]] std::unique_ptr<GridMlpAppearance> take() {
    for (const Tensor& p : fitted_->parameters()) p.requires_grad_(false);
    return std::move(fitted_);
  }

 private:
  const Appearance& target_;
  const scene::TriMesh& mesh_;
  const field::FieldShape& shape_;
  uint64_t seed_;
  int64_t steps_;
  int64_t points_ = 1 << 14;  ///< surface points per step
  std::unique_ptr<GridMlpAppearance> fitted_;
  optimize::AdamMoments moments_;
  std::vector<Tensor> grads_;
};

}  // namespace

std::unique_ptr<GridMlpAppearance> fit_grid_mlp(
    const Appearance& target, const scene::TriMesh& mesh, const field::FieldShape& shape,
    uint64_t seed, int64_t steps, const std::filesystem::path& checkpoint, Progress& progress) {
  constexpr int64_t kCheckpointEvery = 100;
  AppearanceFit fit(target, mesh, shape, seed, steps);
  optimize::run_loop(
      fit,
      {"appearance", steps, kCheckpointEvery, checkpoint,
       "remove grid and mlp from attack.optimize", "remove grid and mlp from attack.optimize"},
      progress);
  return fit.take();
}

}  // namespace tt3d::object
