#include <ATen/ATen.h>
#include <torch/csrc/autograd/autograd.h>

#include <cmath>
#include <optional>

#include "tt3d/attack.h"
#include "tt3d/similarity.h"
#include "tt3d/tensor_file.h"

namespace tt3d {
namespace {

using at::Tensor;

/// Everything that changes while attacking; saved and restored whole.
struct AttackState {
  Tensor offsets;  ///< [V,3]
  Appearance appearance;
  std::vector<Tensor> moment1, moment2;
  std::vector<AttackCurvePoint> curves;
  int64_t step = 0;
  Recovery recovery;
};

/// A parameter with the share of the learning rates that applies to it.
struct Group {
  Tensor parameter;
  double rate;
};

std::vector<Group> free_parameters(const AttackState& s, const AttackMethod& method,
                                   const AttackOptions& options) {
  std::vector<Group> groups;
  if (method.vertices) groups.push_back({s.offsets, options.vertex_rate});
  if (method.grid) groups.push_back({s.appearance.grid, options.appearance_rate});
  if (method.mlp) {
    for (const Tensor& w : s.appearance.color_mlp) groups.push_back({w, options.appearance_rate});
  }
  return groups;
}

AttackState fresh_state(const AttackInput& input, const AttackMethod& method,
                        const AttackOptions& options) {
  AttackState s;
  s.offsets = at::zeros_like(input.mesh.vertices);
  s.appearance = input.appearance.clone();
  for (const Group& g : free_parameters(s, method, options)) {
    g.parameter.requires_grad_(true);
    s.moment1.push_back(at::zeros_like(g.parameter, g.parameter.options().requires_grad(false)));
    s.moment2.push_back(at::zeros_like(g.parameter, g.parameter.options().requires_grad(false)));
  }
  return s;
}

constexpr int64_t kCurveColumns = 8;

Tensor curves_tensor(const std::vector<AttackCurvePoint>& curves) {
  Tensor t = at::empty({static_cast<int64_t>(curves.size()), kCurveColumns}, at::kDouble);
  auto* p = t.mutable_data_ptr<double>();
  for (const AttackCurvePoint& c : curves) {
    for (const double x : {static_cast<double>(c.step), c.loss, c.objective, c.rgb, c.chamfer,
                           c.laplacian, c.edge, c.success}) {
      *p++ = x;
    }
  }
  return t;
}

std::vector<AttackCurvePoint> curves_from(const Tensor& t) {
  std::vector<AttackCurvePoint> curves;
  const auto* p = t.const_data_ptr<double>();
  for (int64_t i = 0; i < t.size(0); ++i, p += kCurveColumns) {
    curves.push_back({static_cast<int64_t>(p[0]), p[1], p[2], p[3], p[4], p[5], p[6], p[7]});
  }
  return curves;
}

void save_state(const AttackState& s, const std::filesystem::path& path) {
  std::vector<std::pair<std::string, Tensor>> tensors = {{"offsets", s.offsets}};
  const auto all = s.appearance.parameters();
  for (size_t i = 0; i < all.size(); ++i)
    tensors.emplace_back("appearance." + std::to_string(i), all[i]);
  for (size_t i = 0; i < s.moment1.size(); ++i) {
    tensors.emplace_back("moment1." + std::to_string(i), s.moment1[i]);
    tensors.emplace_back("moment2." + std::to_string(i), s.moment2[i]);
  }
  tensors.emplace_back("curves", curves_tensor(s.curves));
  tensors.emplace_back("counters", at::tensor({s.step, int64_t{s.recovery.rollbacks}}, at::kLong));
  tensors.emplace_back("rate_scale", at::tensor({s.recovery.rate_scale}, at::kDouble));
  save_tensors(path, tensors, {{"format", "tt3d attack state"}});
}

void load_state(const std::filesystem::path& path, AttackState& s) {
  const TensorFile file = load_tensors(path);
  at::NoGradGuard guard;
  s.offsets.copy_(file.get("offsets", s.offsets.sizes(), at::kFloat));
  const auto all = s.appearance.parameters();
  for (size_t i = 0; i < all.size(); ++i) {
    all[i].copy_(file.get("appearance." + std::to_string(i), all[i].sizes(), at::kFloat));
  }
  for (size_t i = 0; i < s.moment1.size(); ++i) {
    const std::string n = std::to_string(i);
    s.moment1[i].copy_(file.get("moment1." + n, s.moment1[i].sizes(), at::kFloat));
    s.moment2[i].copy_(file.get("moment2." + n, s.moment2[i].sizes(), at::kFloat));
  }
  s.curves = curves_from(file.get("curves", {-1, kCurveColumns}, at::kDouble));
  const Tensor counters = file.get("counters", {2}, at::kLong);
  s.step = counters[0].item<int64_t>();
  s.recovery.rollbacks = counters[1].item<int>();
  s.recovery.rate_scale = file.get("rate_scale", {1}, at::kDouble).item<double>();
}

/// Squared distance that a PSNR stands for, pictures in [0,1].
double mse_of_psnr(double psnr) { return psnr > 0 ? std::pow(10.0, -psnr / 10) : 0.0; }

/// One attack on one object: what stays the same from step to step.
class Attacker {
 public:
  Attacker(const AttackInput& input, const AttackOptions& options, uint64_t seed)
      : input_(input),
        options_(options),
        seed_(seed),
        views_(options.views_per_step),
        method_(attack_method(options.method)),
        clean_(input.appearance.clone()),
        prepared_(input.mesh.faces),
        regularizer_(input.mesh) {
    if (!options.eot.photographs.empty()) photographs_.emplace(options.eot.photographs.string());
    at::NoGradGuard guard;
    rest_edge_ = regularizer_.edge_length(input.mesh.vertices).item<double>();
  }

  /// Views a step; fewer after halve_views.
  [[nodiscard]] int64_t views() const { return views_; }
  void halve_views() { views_ /= 2; }

  [[nodiscard]] AttackState fresh() const { return fresh_state(input_, method_, options_); }

  /// Loss and gradients of a step; the curve point has its parts.
  AttackCurvePoint compute(const AttackState& s, std::vector<Tensor>& grads) const {
    const auto groups = free_parameters(s, method_, options_);
    std::vector<Tensor> parameters;
    for (const Group& g : groups) parameters.push_back(g.parameter);
    const Tensor vertices = input_.mesh.vertices + s.offsets;
    Tensor rgb, missing;
    const Tensor pictures = render(s, vertices, rgb, missing);
    std::vector<Tensor> hits;
    const Tensor objective = adversarial_loss(pictures, s.step, hits);
    const Tensor excess = (rgb - mse_of_psnr(options_.psnr_floor)).clamp_min(0);
    Tensor chamfer = at::zeros({}, vertices.options()), laplacian = chamfer, edge = chamfer;
    if (method_.vertices) {
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

  void apply(const std::vector<Tensor>& grads, AttackState& s) const {
    const Adam adam{0.9, 0.999, 1e-15};
    const double progress = static_cast<double>(s.step) / static_cast<double>(options_.steps);
    const double decay = std::pow(options_.final_rate, progress) * s.recovery.rate_scale;
    const auto groups = free_parameters(s, method_, options_);
    at::NoGradGuard guard;
    for (size_t i = 0; i < groups.size(); ++i) {
      adam.step(groups[i].parameter, grads[i].contiguous(), s.moment1[i], s.moment2[i],
                groups[i].rate * decay, s.step + 1);
    }
  }

 private:
  /// The step's figures, brought to the host at once.
  static AttackCurvePoint curve_point(int64_t step, std::vector<Tensor> figures,
                                      const std::vector<Tensor>& hits) {
    figures.insert(figures.end(), hits.begin(), hits.end());
    for (Tensor& f : figures) f = f.detach().to(at::kDouble);
    const Tensor on_host = at::stack(figures).cpu();
    const auto* f = on_host.const_data_ptr<double>();
    double success = 0;
    for (size_t m = 0; m < hits.size(); ++m) success += f[6 + m] / static_cast<double>(hits.size());
    return {step, f[0], f[1], f[2], f[3], f[4], f[5], success};
  }

  /// Renders the step's views [N,4,H,W]. `rgb` receives R_rgb: the squared distance to the clean
  /// colours at the same surface points, summed over colours and averaged over the pictures' pixels
  /// as a mean squared error (paper, section 3.4). `missing`: what SSIM lacks to its floor.
  Tensor render(const AttackState& s, const Tensor& vertices, Tensor& rgb, Tensor& missing) const {
    std::vector<Camera> cameras;
    const int64_t n = views_;
    for (const SampledView& v : sample_views(options_.view_distribution, seed_, s.step * n, n,
                                             static_cast<int>(options_.image_size), input_.frame)) {
      cameras.push_back(v.camera);
    }
    const auto pixels = static_cast<double>(3 * n * options_.image_size * options_.image_size);
    const bool with_clean = options_.ssim_floor > 0;
    // The appearance sticks to the surface: points are looked up where they rest.
    const Tensor rendered =
        render_mesh(vertices, input_.mesh.vertices, prepared_, cameras, [&](const Tensor& x) {
          const Tensor color = s.appearance.color(x);
          Tensor clean;
          {
            at::NoGradGuard guard;
            clean = clean_.color(x.detach());
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
    missing =
        missing_similarity(color + (1 - alpha), (picture.narrow(1, 3, 3) + 1 - alpha).detach());
    return at::cat({color, alpha}, 1);
  }

  /// What the pictures' mean SSIM lacks to the floor. Every second window is enough for a mean.
  Tensor missing_similarity(const Tensor& pictures, const Tensor& clean) const {
    constexpr int64_t kStride = 2;
    return (options_.ssim_floor - structural_similarity(pictures, clean, kStride).mean())
        .clamp_min(0);
  }

  /// `hits` receives each surrogate's share of pictures that it takes for the target.
  Tensor adversarial_loss(const Tensor& pictures, int64_t step, std::vector<Tensor>& hits) const {
    Tensor total = at::zeros({}, pictures.options());
    const auto models = static_cast<int64_t>(input_.surrogates.size());
    for (int64_t m = 0; m < models; ++m) {
      const Classifier& model = *input_.surrogates[m];
      // Each surrogate sees its own draw of the transforms.
      const Tensor seen =
          transform_images(pictures, model.card().height, options_.eot, seed_, step * models + m,
                           photographs_ ? &*photographs_ : nullptr);
      const Tensor logits = model.logits(seen);
      total = total + objective_loss(options_.objective, logits, input_.targets[m]);
      const Tensor hit = logits.detach().argmax(1) == input_.targets[m];
      hits.push_back(hit.to(at::kDouble).mean());
    }
    return total / static_cast<double>(models);
  }

  const AttackInput& input_;
  const AttackOptions& options_;
  uint64_t seed_;
  int64_t views_;
  AttackMethod method_;
  Appearance clean_;
  RenderMesh prepared_;
  MeshRegularizer regularizer_;
  double rest_edge_ = 0;
  std::optional<Backgrounds> photographs_;
};

/// One step's gradients; where the device's memory is too small for its views, with half of them
/// from then on.
AttackCurvePoint compute_within_memory(Attacker& attacker, const AttackState& s,
                                       std::vector<Tensor>& grads, Progress& progress) {
  for (;;) {
    try {
      return attacker.compute(s, grads);
    } catch (const c10::OutOfMemoryError&) {
      if (attacker.views() == 1) {
        throw ResourceError(
            "attack: out of memory on the device with one view a step; lower attack.image_size");
      }
    }
    attacker.halve_views();
    progress.note("attack: out of memory on the device, going on with " +
                  std::to_string(attacker.views()) + " views a step");
  }
}

void roll_back(const Attacker& attacker, const std::filesystem::path& checkpoint, AttackState& s,
               Progress& progress) {
  const Recovery recovery = s.recovery.after_divergence(
      "attack", s.step, "lower attack.appearance_rate or attack.vertex_rate", progress);
  s = attacker.fresh();
  if (std::filesystem::exists(checkpoint)) load_state(checkpoint, s);
  s.recovery = recovery;
}

}  // namespace

AttackResult run_attack(const AttackInput& input, const AttackOptions& options, uint64_t seed,
                        const std::filesystem::path& checkpoint, Progress& progress) {
  if (input.surrogates.empty()) throw InputError("attack.surrogates: name at least one model");
  if (options.eot.photograph_background > 0 && options.eot.photographs.empty()) {
    throw InputError(
        "attack.eot.photographs: expected a folder, as photograph_background is not 0");
  }
  Attacker attacker(input, options, seed);
  AttackState s = attacker.fresh();
  if (std::filesystem::exists(checkpoint)) load_state(checkpoint, s);
  progress.begin("attack", options.steps, s.step);
  double success = 0, objective = 0, rgb = 0;
  while (s.step < options.steps) {
    std::vector<Tensor> grads;
    const AttackCurvePoint point = compute_within_memory(attacker, s, grads, progress);
    if (!std::isfinite(point.loss)) {
      roll_back(attacker, checkpoint, s, progress);
      continue;
    }
    attacker.apply(grads, s);
    s.curves.push_back(point);
    ++s.step;
    const double keep = s.curves.size() == 1 ? 0.0 : 0.95;
    success = keep * success + (1 - keep) * point.success;
    objective = keep * objective + (1 - keep) * point.objective;
    rgb = keep * rgb + (1 - keep) * point.rgb;
    progress.update(
        s.step,
        {{"loss", objective}, {"asr", success}, {"psnr", rgb > 0 ? -10 * std::log10(rgb) : 99.0}});
    if (s.step % options.checkpoint_every == 0) save_state(s, checkpoint);
    progress.check();
  }
  progress.end();
  AttackResult result;
  result.mesh = {(input.mesh.vertices + s.offsets).detach(), input.mesh.faces};
  result.appearance = s.appearance.clone();
  result.curves = s.curves;
  return result;
}

std::string curves_csv(const std::vector<AttackCurvePoint>& curves) {
  std::string text = "step,loss,objective,rgb,chamfer,laplacian,edge,success\n";
  char line[256];
  for (const AttackCurvePoint& c : curves) {
    std::snprintf(line, sizeof line, "%lld,%.6g,%.6g,%.6g,%.6g,%.6g,%.6g,%.4f\n",
                  static_cast<long long>(c.step), c.loss, c.objective, c.rgb, c.chamfer,
                  c.laplacian, c.edge, c.success);
    text += line;
  }
  return text;
}

void save_attack(const AttackResult& r, const std::filesystem::path& path) {
  const HashGridShape& h = r.appearance.shape;
  std::vector<std::pair<std::string, Tensor>> tensors = {
      {"vertices", r.mesh.vertices},
      {"faces", r.mesh.faces},
      {"curves", curves_tensor(r.curves)},
      {"grid_shape", at::tensor({h.levels, h.base, h.finest, h.log2_size, h.features}, at::kLong)}};
  const auto all = r.appearance.parameters();
  for (size_t i = 0; i < all.size(); ++i)
    tensors.emplace_back("appearance." + std::to_string(i), all[i]);
  save_tensors(path, tensors, {{"format", "tt3d attack"}});
}

AttackResult load_attack(const std::filesystem::path& path) {
  const TensorFile file = load_tensors(path);
  AttackResult r;
  r.mesh = {file.get("vertices", {-1, 3}, at::kFloat), file.get("faces", {-1, 3}, at::kInt)};
  const Tensor h = file.get("grid_shape", {5}, at::kLong);
  const auto* n = h.const_data_ptr<int64_t>();
  r.appearance.shape = {n[0], n[1], n[2], n[3], n[4]};
  r.appearance.grid = file.get("appearance.0", {-1, -1}, at::kFloat);
  for (int i = 1; i <= 3; ++i) {
    const std::string name = "appearance." + std::to_string(i);
    r.appearance.color_mlp.push_back(file.get(name, {-1, -1}, at::kFloat));
  }
  r.curves = curves_from(file.get("curves", {-1, kCurveColumns}, at::kDouble));
  return r;
}

}  // namespace tt3d
