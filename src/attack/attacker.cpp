#include "attacker.h"

#include <ATen/ATen.h>
#include <torch/csrc/autograd/autograd.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "tt3d/similarity.h"

namespace tt3d {
namespace {

using at::Tensor;

/// Squared distance that a PSNR stands for, pictures in [0,1].
double mse_of_psnr(double psnr) { return psnr > 0 ? std::pow(10.0, -psnr / 10) : 0.0; }

/// The step's figures, brought to the host at once.
AttackCurvePoint curve_point(int64_t step, std::vector<Tensor> figures,
                             const std::vector<Tensor>& hits) {
  figures.insert(figures.end(), hits.begin(), hits.end());
  for (Tensor& f : figures) f = f.detach().to(at::kDouble);
  const Tensor on_host = at::stack(figures).cpu();
  const auto* f = on_host.const_data_ptr<double>();
  double success = 0;
  for (size_t m = 0; m < hits.size(); ++m) success += f[6 + m] / static_cast<double>(hits.size());
  return {step, f[0], f[1], f[2], f[3], f[4], f[5], success};
}

}  // namespace

Attacker::Attacker(const AttackInput& input, const AttackOptions& options, uint64_t seed)
    : input_(input),
      options_(options),
      seed_(seed),
      views_(options.views_per_step),
      shape_is_free_(std::find(options.optimize.begin(), options.optimize.end(), "vertices") !=
                     options.optimize.end()),
      ensemble_(input, options, seed),
      prepared_(input.mesh.faces),
      regularizer_(input.mesh) {
  at::NoGradGuard guard;
  rest_edge_ = regularizer_.edge_length(input.mesh.vertices).item<double>();
}

AttackCurvePoint Attacker::compute(const AttackState& s, std::vector<Tensor>& grads) const {
  std::vector<Tensor> parameters;
  for (const FreeParameter& p : free_parameters(s, options_)) parameters.push_back(p.tensor);
  const Tensor vertices = input_.mesh.vertices + s.offsets;
  Tensor rgb, missing;
  const Tensor pictures = render(s, vertices, rgb, missing);
  std::vector<Tensor> hits;
  const Tensor objective = ensemble_.loss(pictures, s.step, hits);
  const Tensor excess = (rgb - mse_of_psnr(options_.psnr_floor)).clamp_min(0);
  Tensor chamfer = at::zeros({}, vertices.options()), laplacian = chamfer, edge = chamfer;
  if (shape_is_free_) {
    chamfer = regularizer_.chamfer(vertices);
    laplacian = regularizer_.laplacian(vertices);
    edge = regularizer_.edge_length(vertices) - rest_edge_;
  }
  const Tensor natural = options_.rgb_weight * excess + options_.chamfer_weight * chamfer +
                         options_.laplacian_weight * laplacian + options_.edge_weight * edge +
                         options_.ssim_weight * missing;
  const Tensor loss = objective + options_.beta * natural;
  grads = torch::autograd::grad({loss}, parameters);
  return curve_point(s.step, {loss, objective, rgb, chamfer, laplacian, edge}, hits);
}

void Attacker::apply(const std::vector<Tensor>& grads, AttackState& s) const {
  const Adam adam{0.9, 0.999, 1e-15};
  const double progress = static_cast<double>(s.step) / static_cast<double>(options_.steps);
  const double decay = std::pow(options_.final_rate, progress) * s.recovery.rate_scale;
  const auto free = free_parameters(s, options_);
  at::NoGradGuard guard;
  for (size_t i = 0; i < free.size(); ++i) {
    adam.step(free[i].tensor, grads[i].contiguous(), s.moment1[i], s.moment2[i],
              free[i].rate * decay, s.step + 1);
  }
  s.appearance->constrain();
}

/// Renders the step's views [N,4,H,W]. `rgb` receives R_rgb: the squared distance to the clean
/// colours at the same surface points, summed over colours and averaged over the pictures' pixels
/// as a mean squared error (paper, section 3.4). `missing`: what SSIM lacks to its floor.
Tensor Attacker::render(const AttackState& s, const Tensor& vertices, Tensor& rgb,
                        Tensor& missing) const {
  std::vector<Camera> sampled;
  const int64_t n = views_;
  for (const SampledView& v : sample_views(options_.view_distribution, seed_, s.step * n, n,
                                           static_cast<int>(options_.image_size), input_.frame)) {
    sampled.push_back(v.camera);
  }
  const auto cameras =
      shift_object(std::move(sampled), input_.frame.radius, options_.eot, seed_, s.step);
  const auto pixels = static_cast<double>(3 * n * options_.image_size * options_.image_size);
  const bool with_clean = options_.ssim_floor > 0;
  // The appearance sticks to the surface: points are looked up where they rest.
  const Tensor rendered = render_mesh(
      vertices, input_.mesh.vertices, prepared_, cameras, [&](const SurfacePoints& points) {
        const Tensor color = s.appearance->color(points);
        Tensor clean;
        {
          at::NoGradGuard guard;
          clean = input_.appearance->color({points.positions.detach(), points.rast.detach()});
        }
        rgb = (color - clean).square().sum() / pixels;
        return with_clean ? at::cat({color, clean}) : color;
      });
  const Tensor picture = rendered.permute({0, 3, 1, 2});
  if (!with_clean) {
    missing = at::zeros({}, picture.options());
    return picture;
  }
  const Tensor color = picture.narrow(1, 0, 3), alpha = picture.narrow(1, 6, 1);
  missing = missing_similarity(color + (1 - alpha), (picture.narrow(1, 3, 3) + 1 - alpha).detach());
  return at::cat({color, alpha}, 1);
}

/// What the pictures' mean SSIM lacks to the floor. Every second window is enough for a mean.
Tensor Attacker::missing_similarity(const Tensor& pictures, const Tensor& clean) const {
  constexpr int64_t kStride = 2;
  return (options_.ssim_floor - structural_similarity(pictures, clean, kStride).mean())
      .clamp_min(0);
}

}  // namespace tt3d
