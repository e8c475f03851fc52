#include "attacker.h"

#include <ATen/ATen.h>
#include <torch/csrc/autograd/autograd.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>

#include "color_space.h"
#include "looks.h"
#include "picture_ops.h"

namespace tt3d {
namespace {

using at::Tensor;

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

/// Gathers gradients over the steps, each scaled to a mean length of 1 first (MI-FGSM; Dong et al.,
/// "Boosting adversarial attacks with momentum", CVPR 2018, equation 6). Returns the velocity.
Tensor accelerate(const Tensor& velocity, const Tensor& gradient, double momentum) {
  return velocity.mul_(momentum).add_(gradient / gradient.abs().mean().clamp_min(1e-30));
}

}  // namespace

const std::vector<std::string>& schedule_names() {
  static const std::vector<std::string> names = {"exponential", "cosine"};
  return names;
}

double rate_share(const AttackOptions& options, double progress) {
  if (options.schedule == "exponential") return std::pow(options.final_rate, progress);
  if (options.schedule == "cosine") {
    const double way = (1 - std::cos(std::numbers::pi * progress)) / 2;
    return 1 + way * (options.final_rate - 1);
  }
  throw InputError("attack.schedule: unknown '" + options.schedule +
                   "', expected exponential or cosine");
}

Attacker::Attacker(const AttackInput& input, const AttackOptions& options, uint64_t seed)
    : input_(input),
      options_(options),
      seed_(seed),
      views_(options.views_per_step),
      ensemble_(input, options, seed),
      naturalness_(input, options),
      prepared_(input.mesh.faces) {
  if (!input.also.empty() && optimizes(options, "vertices")) {
    throw InputError("attack.also: objects share their look alone; leave out vertices");
  }
  for (const AttackInput& other : input.also) {
    also_.push_back(std::make_unique<Attacker>(other, options, seed));
  }
}

void Attacker::halve_views() {
  views_ /= 2;
  for (const auto& other : also_) other->halve_views();
}

AttackState Attacker::wearing(const AttackState& s) const {
  AttackState own;
  own.offsets = at::zeros_like(input_.mesh.vertices);
  own.appearance = s.appearance->worn_by(input_.mesh);
  if (!own.appearance) {
    throw InputError("attack.also: this look fits its own object alone; take a triplanar tile");
  }
  own.step = s.step;
  return own;
}

AttackCurvePoint Attacker::compute(const AttackState& s, std::vector<Tensor>& grads) const {
  AttackCurvePoint point = compute_own(s, grads);
  if (also_.empty()) return point;
  const double share = 1.0 / static_cast<double>(1 + also_.size());
  const auto figures = [](AttackCurvePoint& p) {
    return std::array{&p.loss, &p.objective, &p.rgb, &p.chamfer, &p.laplacian, &p.edge, &p.success};
  };
  for (double* figure : figures(point)) *figure *= share;
  for (Tensor& g : grads) g = g * share;
  for (const auto& other : also_) {
    std::vector<Tensor> added;
    AttackCurvePoint theirs = other->compute_own(other->wearing(s), added);
    for (size_t i = 0; i < figures(point).size(); ++i) {
      *figures(point)[i] += share * *figures(theirs)[i];
    }
    for (size_t i = 0; i < grads.size(); ++i) grads[i] = grads[i] + added[i] * share;
  }
  return point;
}

AttackCurvePoint Attacker::compute_own(const AttackState& s, std::vector<Tensor>& grads) const {
  const auto free = free_parameters(s, options_);
  std::vector<Tensor> parameters;
  parameters.reserve(free.size());
  for (const FreeParameter& p : free) parameters.push_back(p.tensor);
  const Tensor vertices = input_.mesh.vertices + s.offsets;
  const Rendering shown = render(s, vertices);
  std::vector<Tensor> hits;
  const Tensor lit = light_pictures(shown.pictures, shown.normals, options_.eot, seed_, s.step);
  const Tensor objective = ensemble_.loss(lit, competitors(shown), s.step, hits);
  const Naturalness::Terms natural = naturalness_.terms(shown, vertices);
  const Tensor loss = objective + options_.beta * natural.total;
  grads = torch::autograd::grad({loss}, parameters);
  return curve_point(
      s.step, {loss, objective, shown.rgb, natural.chamfer, natural.laplacian, natural.edge}, hits);
}

/// What attack.feature_mix sets against the pictures: the clean object in the same views.
Tensor Attacker::competitors(const Rendering& shown) const {
  return options_.feature_mix > 0 ? shown.clean.detach() : Tensor();
}

void Attacker::apply(const std::vector<Tensor>& grads, AttackState& s) const {
  const Adam adam{0.9, 0.999, 1e-15};
  const double progress = static_cast<double>(s.step) / static_cast<double>(options_.steps);
  const double decay = rate_share(options_, progress) * s.recovery.rate_scale;
  const auto free = free_parameters(s, options_);
  at::NoGradGuard guard;
  for (size_t i = 0; i < free.size(); ++i) {
    Tensor direction = grads[i].contiguous();
    if (options_.momentum > 0) direction = accelerate(s.velocity[i], direction, options_.momentum);
    adam.step(free[i].tensor, direction, s.moment1[i], s.moment2[i], free[i].rate * decay,
              s.step + 1);
  }
  if (options_.max_displacement > 0) limit_offsets(s.offsets, options_.max_displacement);
  s.appearance->constrain();
}

std::vector<Camera> Attacker::cameras(int64_t step) const {
  std::vector<Camera> sampled;
  for (const SampledView& v : sample_views(options_.view_distribution, seed_, step * views_, views_,
                                           static_cast<int>(options_.image_size), input_.frame)) {
    sampled.push_back(v.camera);
  }
  return shift_object(std::move(sampled), input_.frame.radius, options_.eot, seed_, step);
}

double Attacker::held_out_success(const AttackState& s) const {
  constexpr uint64_t kHeldOut = 0x0E90C4ULL;  // a seed of its own: neither training nor evaluation
  at::NoGradGuard guard;
  const Tensor vertices = input_.mesh.vertices + s.offsets;
  const auto size = static_cast<int>(options_.image_size);
  double sum = 0;
  for (int64_t first = 0; first < options_.held_out_views; first += views_) {
    const int64_t count = std::min(views_, options_.held_out_views - first);
    std::vector<Camera> cameras;
    for (const SampledView& v : sample_views(options_.view_distribution, seed_ ^ kHeldOut, first,
                                             count, size, input_.frame)) {
      cameras.push_back(v.camera);
    }
    const Tensor shown =
        render_mesh(vertices, input_.mesh.vertices, prepared_, cameras,
                    [&](const SurfacePoints& points) { return s.appearance->color(points); })
            .permute({0, 3, 1, 2});
    sum += ensemble_.success(over_white(shown).clamp(0, 1)) * static_cast<double>(count);
  }
  double mean = sum / static_cast<double>(options_.held_out_views);
  for (const auto& other : also_) mean += other->held_out_success(other->wearing(s));
  return mean / static_cast<double>(1 + also_.size());
}

/// Renders the step's views: the colours and, where they are asked for, the clean colours and the
/// normals, as channels of one picture.
Rendering Attacker::render(const AttackState& s, const Tensor& vertices) const {
  const auto pixels = static_cast<double>(3 * views_ * options_.image_size * options_.image_size);
  const bool with_clean = naturalness_.compares_pictures() || options_.feature_mix > 0;
  const bool with_normals = options_.eot.light > 0;
  Rendering shown;
  // The appearance sticks to the surface: points are looked up where they rest.
  const Tensor rendered = render_mesh(
      vertices, input_.mesh.vertices, prepared_, cameras(s.step), [&](const SurfacePoints& points) {
        shown.colors = s.appearance->color(points);
        Tensor clean;
        {
          at::NoGradGuard guard;
          clean = input_.appearance->color({points.positions.detach(), points.rast.detach()});
        }
        shown.rgb = color_distance(options_.color_space, shown.colors, clean) / pixels;
        std::vector<Tensor> channels = {shown.colors};
        if (with_clean) {
          channels.push_back(clean);
          channels.push_back(at::ones({1, clean.size(1)}, clean.options()));  // its alpha
        }
        if (with_normals) {
          channels.push_back(
              at_points(vertex_normals(vertices, prepared_.faces), points, prepared_.faces));
        }
        return channels.size() == 1 ? shown.colors : at::cat(channels);
      });
  // Taken apart while channels lie side by side: so do those of the gradients then.
  const auto channels = [&](int64_t first, int64_t count) {
    return rendered.narrow(3, first, count).permute({0, 3, 1, 2});
  };
  shown.pictures = channels(0, 4);
  if (with_clean) shown.clean = channels(4, 4);
  if (with_normals) shown.normals = channels(with_clean ? 8 : 4, 3);
  return shown;
}

}  // namespace tt3d
