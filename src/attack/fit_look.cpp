#include <ATen/ATen.h>
#include <torch/csrc/autograd/autograd.h>

#include <cmath>

#include "tt3d/appearance.h"

namespace tt3d {

using at::Tensor;

SurfacePoints sample_surface(const TriMesh& mesh, int64_t count, Random random) {
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
    // Even over a triangle: fold the unit square's upper half back (Osada et al. 2002).
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

std::unique_ptr<GridMlpAppearance> fit_grid_mlp(const Appearance& look, const TriMesh& mesh,
                                                const FieldShape& shape, uint64_t seed,
                                                int64_t steps, Progress& progress) {
  constexpr int64_t kPoints = 1 << 14;
  constexpr double kRate = 1e-2, kFinal = 0.1;
  auto fitted = std::make_unique<GridMlpAppearance>(
      RadianceField::create(shape, seed).appearance.to(mesh.vertices.device()));
  const auto parameters = fitted->parameters();
  std::vector<Tensor> moment1, moment2;
  for (const Tensor& p : parameters) {
    p.requires_grad_(true);
    moment1.push_back(at::zeros_like(p));
    moment2.push_back(at::zeros_like(p));
  }
  progress.begin("look", steps, 0);
  for (int64_t step = 0; step < steps; ++step) {
    const SurfacePoints points =
        sample_surface(mesh, kPoints, Random(seed, "attack/look", static_cast<uint64_t>(step)));
    Tensor wanted;
    {
      at::NoGradGuard guard;
      wanted = look.color(points);
    }
    const auto grads =
        torch::autograd::grad({(fitted->color(points) - wanted).square().mean()}, parameters);
    at::NoGradGuard guard;
    const double rate =
        kRate * std::pow(kFinal, static_cast<double>(step) / static_cast<double>(steps));
    for (size_t i = 0; i < parameters.size(); ++i) {
      Adam{}.step(parameters[i], grads[i].contiguous(), moment1[i], moment2[i], rate, step + 1);
    }
    progress.update(step + 1, {});
    progress.check();
  }
  progress.end();
  for (const Tensor& p : parameters) p.requires_grad_(false);
  return fitted;
}

}  // namespace tt3d
