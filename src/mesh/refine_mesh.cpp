#include <ATen/ATen.h>
#include <torch/csrc/autograd/autograd.h>

#include <cmath>
#include <map>
#include <memory>

#include "tt3d/mesh.h"
#include "tt3d/tensor_file.h"

namespace tt3d {
namespace {

using at::Tensor;

/// Everything that changes while refining; saved and restored whole.
struct RefineState {
  TriMesh mesh;    ///< base of the offsets; changes at each remeshing
  Tensor offsets;  ///< [V,3]
  GridMlp appearance;
  std::vector<Tensor> moment1, moment2;  ///< offsets first, then the appearance
  int64_t step = 0;
  int64_t since_remesh = 0;  ///< Adam's iteration for the offsets
  Recovery recovery;

  [[nodiscard]] std::vector<Tensor> parameters() const {
    std::vector<Tensor> all = {offsets};
    const auto rest = appearance.parameters();
    all.insert(all.end(), rest.begin(), rest.end());
    return all;
  }
};

void reset_offsets(RefineState& s) {
  s.offsets = at::zeros_like(s.mesh.vertices).requires_grad_(true);
  s.since_remesh = 0;
  if (s.moment1.empty()) return;
  s.moment1[0] = at::zeros_like(s.mesh.vertices);
  s.moment2[0] = at::zeros_like(s.mesh.vertices);
}

RefineState fresh_state(const TriMesh& mesh, const GridMlp& appearance) {
  RefineState s;
  s.mesh = mesh;
  s.appearance = appearance.clone();
  reset_offsets(s);
  for (const Tensor& p : s.parameters()) {
    s.moment1.push_back(at::zeros_like(p, p.options().requires_grad(false)));
    s.moment2.push_back(at::zeros_like(p, p.options().requires_grad(false)));
  }
  for (const Tensor& p : s.appearance.parameters()) p.requires_grad_(true);
  return s;
}

void save_state(const RefineState& s, const std::filesystem::path& path) {
  std::vector<std::pair<std::string, Tensor>> tensors = {{"vertices", s.mesh.vertices},
                                                         {"faces", s.mesh.faces}};
  const auto all = s.parameters();
  for (size_t i = 0; i < all.size(); ++i) {
    const std::string n = std::to_string(i);
    tensors.emplace_back("parameter." + n, all[i]);
    tensors.emplace_back("moment1." + n, s.moment1[i]);
    tensors.emplace_back("moment2." + n, s.moment2[i]);
  }
  tensors.emplace_back(
      "counters", at::tensor({s.step, s.since_remesh, int64_t{s.recovery.rollbacks}}, at::kLong));
  tensors.emplace_back("rate_scale",
                       at::tensor({static_cast<float>(s.recovery.rate_scale)}, at::kFloat));
  save_tensors(path, tensors, {{"format", "tt3d refinement"}});
}

void load_state(const std::filesystem::path& path, RefineState& s) {
  const TensorFile file = load_tensors(path);
  s.mesh =
      TriMesh{file.get("vertices", {-1, 3}, at::kFloat), file.get("faces", {-1, 3}, at::kInt)}.to(
          s.offsets.device());
  reset_offsets(s);
  at::NoGradGuard guard;
  const auto all = s.parameters();
  for (size_t i = 0; i < all.size(); ++i) {
    const std::string n = std::to_string(i);
    all[i].copy_(file.get("parameter." + n, all[i].sizes(), at::kFloat));
    s.moment1[i].copy_(file.get("moment1." + n, all[i].sizes(), at::kFloat));
    s.moment2[i].copy_(file.get("moment2." + n, all[i].sizes(), at::kFloat));
  }
  const Tensor counters = file.get("counters", {3}, at::kLong);
  s.step = counters[0].item<int64_t>();
  s.since_remesh = counters[1].item<int64_t>();
  s.recovery.rollbacks = counters[2].item<int>();
  s.recovery.rate_scale = file.get("rate_scale", {1}, at::kFloat).item<double>();
}

/// Views are grouped by picture size, so that a batch rasterises in one call.
std::vector<std::vector<size_t>> groups_by_size(const std::vector<View>& views) {
  std::map<std::pair<int, int>, std::vector<size_t>> groups;
  for (size_t i = 0; i < views.size(); ++i) {
    groups[{views[i].camera.width, views[i].camera.height}].push_back(i);
  }
  std::vector<std::vector<size_t>> out;
  for (auto& [size, list] : groups) out.push_back(std::move(list));
  return out;
}

/// The views of a step: one group, drawn by its share of all views, then views of it.
std::vector<size_t> draw_views(const std::vector<std::vector<size_t>>& groups, size_t total,
                               int64_t count, uint64_t seed, int64_t step) {
  Random random(seed, "mesh/views", static_cast<uint64_t>(step));
  auto pick = random.index(static_cast<int64_t>(total));
  const std::vector<size_t>* group = groups.data();
  while (pick >= static_cast<int64_t>(group->size()))
    pick -= static_cast<int64_t>((group++)->size());
  std::vector<size_t> views;
  for (int64_t i = 0; i < count; ++i) {
    views.push_back((*group)[random.index(static_cast<int64_t>(group->size()))]);
  }
  return views;
}

struct StepLoss {
  double total = 0, mse = 0;
};

StepLoss compute_gradients(const Capture& capture, const std::vector<Tensor>& targets,
                           const std::vector<size_t>& picked, const MeshOptions& options,
                           uint64_t seed, const RefineState& s, const RenderMesh& prepared,
                           const MeshRegularizer& regularizer, std::vector<Tensor>& grads) {
  std::vector<Camera> cameras;
  std::vector<Tensor> wanted;
  for (const size_t v : picked) {
    cameras.push_back(capture.train[v].camera);
    wanted.push_back(targets[v]);
  }
  const Tensor target = at::stack(wanted);
  const Tensor vertices = s.mesh.vertices + s.offsets;
  const Tensor rendered =
      render_mesh(vertices, vertices, prepared, cameras,
                  [&](const SurfacePoints& p) { return s.appearance.color(p.positions); });
  Random random(seed, "mesh/background", static_cast<uint64_t>(s.step));
  const Tensor background =
      at::tensor({random.uniform(), random.uniform(), random.uniform()}).to(target.device());
  const Tensor mse =
      (over_background(rendered, background) - over_background(target, background)).square().mean();
  const Tensor loss =
      mse + options.mask_weight * (rendered.select(3, 3) - target.select(3, 3)).square().mean() +
      options.laplacian_weight * regularizer.laplacian(vertices) +
      options.offset_weight * s.offsets.square().sum(1).mean();
  grads = torch::autograd::grad({loss}, s.parameters());
  // The step's one way back to the host.
  const Tensor figures = at::stack({loss.detach(), mse.detach()}).cpu();
  return {figures[0].item<double>(), figures[1].item<double>()};
}

void apply_gradients(const MeshOptions& options, const std::vector<Tensor>& grads, RefineState& s) {
  const Adam adam;
  // Exponential decay to a tenth over the stage.
  const double decay =
      std::pow(0.1, static_cast<double>(s.step) / static_cast<double>(options.refine_steps));
  const auto parameters = s.parameters();
  at::NoGradGuard guard;
  for (size_t i = 0; i < parameters.size(); ++i) {
    const bool offsets = i == 0;
    const double rate =
        (offsets ? options.vertex_rate : options.appearance_rate) * decay * s.recovery.rate_scale;
    adam.step(parameters[i], grads[i].contiguous(), s.moment1[i], s.moment2[i], rate,
              offsets ? s.since_remesh + 1 : s.step + 1);
  }
}

/// Mean squared colour error of each face over all training views, 0 for faces never seen.
Tensor face_errors(const Capture& capture, const std::vector<Tensor>& targets, const RefineState& s,
                   const RenderMesh& prepared) {
  at::NoGradGuard guard;
  const int64_t count = s.mesh.faces.size(0);
  Tensor sum = at::zeros({count + 1}, s.mesh.vertices.options());
  Tensor pixels = at::zeros_like(sum);
  const Tensor vertices = s.mesh.vertices + s.offsets;
  for (size_t v = 0; v < capture.train.size(); ++v) {
    Tensor rast;
    const Tensor rendered = render_mesh(
        vertices, vertices, prepared, {capture.train[v].camera},
        [&](const SurfacePoints& p) { return s.appearance.color(p.positions); }, &rast);
    const Tensor error = (rendered[0] - targets[v]).square().sum(2).flatten();
    const Tensor face = rast.select(3, 3).flatten().to(at::kLong);
    sum.index_add_(0, face, error);
    pixels.index_add_(0, face, at::ones_like(error));
  }
  return (sum / pixels.clamp_min(1)).narrow(0, 1, count);
}

/// The `share` of faces with the smallest (or largest) error, [F] bool.
Tensor extreme_faces(const Tensor& error, double share, bool largest) {
  const int64_t count = error.size(0);
  const auto chosen = static_cast<int64_t>(share * static_cast<double>(count));
  const Tensor order = std::get<1>(error.sort(/*dim=*/0, /*descending=*/largest));
  return at::zeros({count}, error.options().dtype(at::kBool))
      .index_fill_(0, order.narrow(0, 0, chosen), true);
}

/// Thins the best faces, then splits the worst, within the options' bounds on their number.
void remesh(const Capture& capture, const std::vector<Tensor>& targets, const MeshOptions& options,
            RefineState& s) {
  const at::Device device = s.mesh.vertices.device();
  s.mesh.vertices = (s.mesh.vertices + s.offsets).detach();
  reset_offsets(s);
  const auto errors = [&] { return face_errors(capture, targets, s, RenderMesh(s.mesh.faces)); };
  const double kept = 1 - options.decimate_share * (1 - options.decimate_ratio);
  if (kept * static_cast<double>(s.mesh.faces.size(0)) >= static_cast<double>(options.min_faces)) {
    const Tensor best = extreme_faces(errors(), options.decimate_share, false);
    s.mesh =
        drop_small_components(decimate(s.mesh, best, options.decimate_ratio), options.min_component)
            .to(device);
    reset_offsets(s);
  }
  const Tensor worst = extreme_faces(errors(), options.split_share, true);
  const TriMesh divided = subdivide(s.mesh, worst, options.min_edge);
  if (divided.faces.size(0) <= options.max_faces) s.mesh = divided.to(device);
  reset_offsets(s);
}

bool remesh_now(const MeshOptions& options, int64_t step) {
  for (const double share : options.remesh_at) {
    if (step == static_cast<int64_t>(share * static_cast<double>(options.refine_steps)) && step > 0)
      return true;
  }
  return false;
}

}  // namespace

RefinedMesh refine_mesh(const TriMesh& start, const GridMlp& appearance, const Capture& capture,
                        const MeshOptions& options, uint64_t seed,
                        const std::filesystem::path& checkpoint, Progress& progress) {
  const at::Device device = appearance.grid.device();
  const TriMesh mesh = start.to(device);
  std::vector<Tensor> targets;
  for (const View& view : capture.train) targets.push_back(premultiplied(view).to(device));
  const auto groups = groups_by_size(capture.train);
  RefineState s = fresh_state(mesh, appearance);
  if (std::filesystem::exists(checkpoint)) load_state(checkpoint, s);
  auto prepared = std::make_unique<RenderMesh>(s.mesh.faces);
  auto regularizer = std::make_unique<MeshRegularizer>(s.mesh);
  progress.begin("mesh", options.refine_steps, s.step);
  double smoothed = 0;
  while (s.step < options.refine_steps) {
    if (remesh_now(options, s.step) && s.since_remesh > 0) {
      remesh(capture, targets, options, s);
      prepared = std::make_unique<RenderMesh>(s.mesh.faces);
      regularizer = std::make_unique<MeshRegularizer>(s.mesh);
    }
    const auto picked =
        draw_views(groups, capture.train.size(), options.views_per_step, seed, s.step);
    std::vector<Tensor> grads;
    const StepLoss loss = compute_gradients(capture, targets, picked, options, seed, s, *prepared,
                                            *regularizer, grads);
    if (!std::isfinite(loss.total)) {
      const Recovery recovery = s.recovery.after_divergence(
          "mesh refinement", s.step, "lower mesh.vertex_rate or mesh.appearance_rate", progress);
      s = fresh_state(mesh, appearance);
      if (std::filesystem::exists(checkpoint)) load_state(checkpoint, s);
      s.recovery = recovery;
      prepared = std::make_unique<RenderMesh>(s.mesh.faces);
      regularizer = std::make_unique<MeshRegularizer>(s.mesh);
      continue;
    }
    apply_gradients(options, grads, s);
    ++s.step;
    ++s.since_remesh;
    smoothed = smoothed == 0 ? loss.mse : 0.95 * smoothed + 0.05 * loss.mse;
    progress.update(s.step, {{"loss", loss.total},
                             {"psnr", -10 * std::log10(smoothed)},
                             {"faces", static_cast<double>(s.mesh.faces.size(0))}});
    if (s.step % options.checkpoint_every == 0) save_state(s, checkpoint);
    progress.check();
  }
  progress.end();
  RefinedMesh out;
  out.mesh = {(s.mesh.vertices + s.offsets).detach(), s.mesh.faces};
  out.appearance = s.appearance.clone();
  return out;
}

}  // namespace tt3d
