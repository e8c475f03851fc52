#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>
#include <torch/csrc/autograd/autograd.h>

#include <cmath>
#include <map>
#include <memory>

#include "tt3d/capture.h"
#include "tt3d/image.h"
#include "tt3d/mesh.h"
#include "tt3d/object.h"
#include "tt3d/optimize.h"
#include "tt3d/raster.h"
#include "tt3d/scene.h"
#include "tt3d/surface.h"

namespace tt3d::mesh {
namespace {

using at::Tensor;

/// Groups views by picture size, so that one call can rasterise a batch.
std::vector<std::vector<size_t>> groups_by_size(const std::vector<capture::View>& views) {
  std::map<std::pair<int, int>, std::vector<size_t>> groups;
  for (size_t i = 0; i < views.size(); ++i) {
    groups[{views[i].camera.width, views[i].camera.height}].push_back(i);
  }
  std::vector<std::vector<size_t>> out;
  for (auto& [size, list] : groups) out.push_back(std::move(list));
  return out;
}

/// The views of a step: a random group, with probability proportional to its size, then random
/// views of the group.
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

/// Selects the `share` of faces with the smallest (or largest) error, [F] bool.
Tensor extreme_faces(const Tensor& error, double share, bool largest) {
  const int64_t count = error.size(0);
  const auto chosen = static_cast<int64_t>(share * static_cast<double>(count));
  const Tensor order = std::get<1>(error.sort(/*dim=*/0, /*descending=*/largest));
  return at::zeros({count}, error.options().dtype(at::kBool))
      .index_fill_(0, order.narrow(0, 0, chosen), true);
}

bool remesh_now(const MeshOptions& options, int64_t step) {
  for (const double share : options.remesh_at) {
    if (step == static_cast<int64_t>(share * static_cast<double>(options.refine_steps)) && step > 0)
      return true;
  }
  return false;
}

/// Refinement of a mesh: its steps, and the state that a checkpoint holds.
class Refinement final : public optimize::Optimization {
 public:
  Refinement(const scene::TriMesh& mesh, const field::GridMlp& appearance,
             const capture::Capture& capture, const MeshOptions& options, uint64_t seed);

  void restart() override;
  void visit_state(optimize::StateVisitor& visit) override;
  optimize::StepLoss compute(int64_t step) override;
  void apply(int64_t step, double rate_scale) override;
  bool halve_batch() override;
  [[nodiscard]] object::Object result() const;

 private:
  [[nodiscard]] std::vector<Tensor> parameters() const;
  [[nodiscard]] Tensor vertices() const { return mesh_.vertices + offsets_; }
  void reset_offsets();
  void prepare();
  void remesh();
  [[nodiscard]] Tensor face_errors() const;
  [[nodiscard]] Tensor loss_of(const std::vector<size_t>& views, int64_t step, Tensor& mse) const;

  const scene::TriMesh start_;
  const field::GridMlp& start_appearance_;
  const capture::Capture& capture_;
  const MeshOptions& options_;
  uint64_t seed_;
  /// The photographs on the device, 8 bits, straight alpha. Each step converts those it uses:
  /// all of them as float32 would take four times the memory.
  std::vector<Tensor> photographs_;
  std::vector<std::vector<size_t>> groups_;
  int64_t views_;  ///< photographs per step; lowered if memory runs out
  // State.
  scene::TriMesh mesh_;  ///< base of the offsets; changes at each remeshing
  Tensor offsets_;       ///< [V,3]
  field::GridMlp appearance_;
  optimize::AdamMoments moments_;  ///< offsets first, then the appearance
  int64_t since_remesh_ = 0;       ///< Adam's iteration for the offsets
  // Derived from the mesh.
  std::unique_ptr<RenderMesh> prepared_;
  std::unique_ptr<MeshRegularizer> regularizer_;
  // Of the last step.
  std::vector<Tensor> grads_;
  double smoothed_mse_ = 0;
};

Refinement::Refinement(const scene::TriMesh& mesh, const field::GridMlp& appearance,
                       const capture::Capture& capture, const MeshOptions& options, uint64_t seed)
    : start_(mesh.to(appearance.grid.device())),
      start_appearance_(appearance),
      capture_(capture),
      options_(options),
      seed_(seed),
      groups_(groups_by_size(capture.train)),
      views_(options.views_per_step) {
  for (const capture::View& view : capture.train) {
    photographs_.push_back(view.rgba.to(appearance.grid.device()));
  }
}

std::vector<Tensor> Refinement::parameters() const {
  std::vector<Tensor> all = {offsets_};
  for (const Tensor& t : appearance_.parameters()) all.push_back(t);
  return all;
}

void Refinement::reset_offsets() {
  offsets_ = at::zeros_like(mesh_.vertices).requires_grad_(true);
  since_remesh_ = 0;
  if (moments_.first.empty()) return;
  moments_.first[0] = at::zeros_like(mesh_.vertices);
  moments_.second[0] = at::zeros_like(mesh_.vertices);
}

void Refinement::prepare() {
  prepared_ = std::make_unique<RenderMesh>(mesh_.faces);
  regularizer_ = std::make_unique<MeshRegularizer>(mesh_);
}

void Refinement::restart() {
  mesh_ = start_;
  appearance_ = start_appearance_.clone();
  reset_offsets();
  moments_.restart(parameters());
  for (const Tensor& p : appearance_.parameters()) p.requires_grad_(true);
  prepare();
}

void Refinement::visit_state(optimize::StateVisitor& visit) {
  visit.replace("vertices", mesh_.vertices);
  visit.replace("faces", mesh_.faces);
  if (visit.reading()) {
    reset_offsets();
    prepare();
  }
  visit.integer("since_remesh", since_remesh_);
  visit.tensors("parameter", parameters());
  moments_.visit(visit);
}

Tensor Refinement::loss_of(const std::vector<size_t>& views, int64_t step, Tensor& mse) const {
  std::vector<scene::Camera> cameras;
  std::vector<Tensor> wanted;
  for (const size_t v : views) {
    cameras.push_back(capture_.train[v].camera);
    wanted.push_back(image::premultiplied(photographs_[v]));
  }
  const Tensor target = at::stack(wanted);
  const Tensor moved = vertices();
  const Tensor rendered =
      render_mesh(moved, moved, *prepared_, cameras,
                  [&](const raster::SurfacePoints& p) { return appearance_.color(p.positions); });
  Random random(seed_, "mesh/background", static_cast<uint64_t>(step));
  const Tensor background =
      at::tensor({random.uniform(), random.uniform(), random.uniform()}).to(target.device());
  mse = (image::over_background(rendered, background) - image::over_background(target, background))
            .square()
            .mean();
  return mse +
         options_.mask_weight * (rendered.select(3, 3) - target.select(3, 3)).square().mean() +
         options_.laplacian_weight * regularizer_->laplacian(moved) +
         options_.offset_weight * offsets_.square().sum(1).mean();
}

optimize::StepLoss Refinement::compute(int64_t step) {
  if (remesh_now(options_, step) && since_remesh_ > 0) remesh();
  Tensor mse;
  const Tensor loss =
      loss_of(draw_views(groups_, capture_.train.size(), views_, seed_, step), step, mse);
  grads_ = torch::autograd::grad({loss}, parameters());
  // The only copy to the host in a step.
  const Tensor figures = at::stack({loss.detach(), mse.detach()}).cpu();
  const auto value = figures[0].item<double>(), error = figures[1].item<double>();
  smoothed_mse_ = smoothed_mse_ == 0 ? error : 0.95 * smoothed_mse_ + 0.05 * error;
  return {value,
          {{"loss", value},
           {"psnr", -10 * std::log10(smoothed_mse_)},
           {"faces", static_cast<double>(mesh_.faces.size(0))}}};
}

void Refinement::apply(int64_t step, double rate_scale) {
  const optimize::Adam adam;
  // Factor on the learning rate: exponential decay to a tenth over the stage.
  const double decay =
      std::pow(0.1, static_cast<double>(step) / static_cast<double>(options_.refine_steps));
  const auto all = parameters();
  at::NoGradGuard guard;
  for (size_t i = 0; i < all.size(); ++i) {
    const bool offsets = i == 0;
    const double rate =
        (offsets ? options_.vertex_rate : options_.appearance_rate) * decay * rate_scale;
    adam.step(all[i], grads_[i].contiguous(), moments_.first[i], moments_.second[i], rate,
              offsets ? since_remesh_ + 1 : step + 1);
  }
  grads_.clear();  // the next step takes their memory
  ++since_remesh_;
}

bool Refinement::halve_batch() {
  if (views_ == 1) return false;
  views_ /= 2;
  return true;
}

/// Mean squared colour error of each face over all training views; 0 for faces that no view sees.
Tensor Refinement::face_errors() const {
  at::NoGradGuard guard;
  const RenderMesh prepared(mesh_.faces);
  const int64_t count = mesh_.faces.size(0);
  Tensor sum = at::zeros({count + 1}, mesh_.vertices.options());
  Tensor pixels = at::zeros_like(sum);
  const Tensor moved = vertices();
  for (size_t v = 0; v < capture_.train.size(); ++v) {
    Tensor rast;
    const Tensor rendered = render_mesh(
        moved, moved, prepared, {capture_.train[v].camera},
        [&](const raster::SurfacePoints& p) { return appearance_.color(p.positions); }, &rast);
    const Tensor error =
        (rendered[0] - image::premultiplied(photographs_[v])).square().sum(2).flatten();
    const Tensor face = rast.select(3, 3).flatten().to(at::kLong);
    sum.index_add_(0, face, error);
    pixels.index_add_(0, face, at::ones_like(error));
  }
  return (sum / pixels.clamp_min(1)).narrow(0, 1, count);
}

/// Decimates the faces with the smallest error and splits those with the largest. Their number
/// stays within the bounds of the options.
void Refinement::remesh() {
  const at::Device device = mesh_.vertices.device();
  mesh_.vertices = vertices().detach();
  reset_offsets();
  const double kept = 1 - options_.decimate_share * (1 - options_.decimate_ratio);
  if (kept * static_cast<double>(mesh_.faces.size(0)) >= static_cast<double>(options_.min_faces)) {
    const Tensor best = extreme_faces(face_errors(), options_.decimate_share, false);
    mesh_ = drop_small_components(decimate(mesh_, best, options_.decimate_ratio),
                                  options_.min_component)
                .to(device);
    reset_offsets();
  }
  const Tensor worst = extreme_faces(face_errors(), options_.split_share, true);
  const scene::TriMesh divided = subdivide(mesh_, worst, options_.min_edge);
  if (divided.faces.size(0) <= options_.max_faces) mesh_ = divided.to(device);
  reset_offsets();
  prepare();
}

object::Object Refinement::result() const {
  return {{vertices().detach(), mesh_.faces},
          std::make_shared<object::GridMlpAppearance>(appearance_.clone()),
          {}};
}

}  // namespace

object::Object refine_mesh(const scene::TriMesh& mesh, const field::GridMlp& appearance,
                           const capture::Capture& capture, const MeshOptions& options,
                           uint64_t seed, const std::filesystem::path& checkpoint,
                           Progress& progress) {
  Refinement refinement(mesh, appearance, capture, options, seed);
  optimize::run_loop(refinement,
                     {"mesh", options.refine_steps, options.checkpoint_every, checkpoint,
                      "lower mesh.vertex_rate or mesh.appearance_rate",
                      "lower capture.max_size or mesh.max_faces"},
                     progress);
  return refinement.result();
}

}  // namespace tt3d::mesh
