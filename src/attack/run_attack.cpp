#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>

#include <cmath>
#include <memory>
#include <numbers>

#include "object_terms.h"
#include "run_attack.h"
#include "starting_appearance.h"

namespace tt3d::attack {

using at::Tensor;

namespace {

/// Accumulates gradients over the steps, each scaled to a mean magnitude of 1 (MI-FGSM; Dong et
/// al., "Boosting adversarial attacks with momentum", CVPR 2018, equation 6). Returns the velocity.
Tensor accelerate(const Tensor& velocity, const Tensor& gradient, double momentum) {
  return velocity.mul_(momentum).add_(gradient / gradient.abs().mean().clamp_min(1e-30));
}

std::unique_ptr<object::Appearance> apply_to(const object::Appearance& appearance,
                                             const scene::TriMesh& mesh) {
  auto applied = appearance.applied_to(mesh);
  if (!applied) {
    throw InputError(
        "attack.also: this appearance belongs to one object; use part tile with tile_mapping "
        "triplanar");
  }
  return applied;
}

/// A log as a tensor [rows, 1 + columns] float64, and back.
template <typename Row>
Tensor log_tensor(const std::vector<Row>& rows) {
  const auto& list = record::columns(static_cast<const Row*>(nullptr));
  const auto width = static_cast<int64_t>(list.size()) + 1;
  Tensor t = at::empty({static_cast<int64_t>(rows.size()), width}, at::kDouble);
  auto* p = t.mutable_data_ptr<double>();
  for (const Row& row : rows) {
    *p++ = static_cast<double>(row.step);
    for (const auto& column : list) *p++ = row.*column.member;
  }
  return t;
}

template <typename Row>
std::vector<Row> log_from(const Tensor& t) {
  const auto& list = record::columns(static_cast<const Row*>(nullptr));
  std::vector<Row> rows(static_cast<size_t>(t.size(0)));
  const auto* p = t.const_data_ptr<double>();
  for (Row& row : rows) {
    row.step = static_cast<int64_t>(*p++);
    for (const auto& column : list) row.*column.member = *p++;
  }
  return rows;
}

/// Reads or writes a log as part of a checkpoint.
template <typename Row>
void visit_log(optimize::StateVisitor& visit, const char* name, std::vector<Row>& rows) {
  Tensor t = log_tensor(rows);
  visit.replace(name, t);
  if (visit.reading()) rows = log_from<Row>(t);
}

}  // namespace

double rate_share(const ScheduleOptions& options, double progress) {
  if (options.schedule == Schedule::kExponential) return std::pow(options.final_rate, progress);
  const double way = (1 - std::cos(std::numbers::pi * progress)) / 2;
  return 1 + way * (options.final_rate - 1);
}

// ---- The state ----------------------------------------------------------------------------

Attack::Attack(const AttackInput& input, const AttackOptions& options, uint64_t seed)
    : input_(input), options_(options) {
  if (!input.also.empty() && options.optimizes(object::Part::kVertices)) {
    throw InputError(
        "attack.also: several objects can share an appearance, not a shape; remove vertices");
  }
  objects_.push_back(std::make_unique<ObjectTerms>(input, options, seed));
  for (const AttackInput& other : input.also) {
    objects_.push_back(std::make_unique<ObjectTerms>(other, options, seed));
  }
}

Attack::~Attack() = default;

void Attack::restart() {
  offsets_ = at::zeros_like(input_.object.mesh.vertices);
  appearance_ = starting_appearance(input_, options_);
  velocity_.clear();
  std::vector<Tensor> parameters;
  for (const FreeParameter& p : free_parameters()) {
    parameters.push_back(p.tensor);
    if (options_.schedule.momentum > 0) velocity_.push_back(at::zeros_like(p.tensor));
    p.tensor.requires_grad_(true);
  }
  moments_.restart(parameters);
  curves_.clear();
  epochs_.clear();
  best_ = {};
}

std::vector<FreeParameter> Attack::free_parameters() const {
  const ScheduleOptions& schedule = options_.schedule;
  std::vector<FreeParameter> free;
  if (options_.optimizes(object::Part::kVertices)) {
    free.push_back({offsets_, schedule.vertex_rate});
  }
  for (const object::ParameterGroup& group : appearance_->groups()) {
    if (!options_.optimizes(group.part)) continue;
    for (const Tensor& t : group.tensors) free.push_back({t, schedule.appearance_rate});
  }
  return free;
}

std::vector<Tensor> Attack::object_tensors() const {
  std::vector<Tensor> all = {offsets_};
  for (const Tensor& t : appearance_->parameters()) all.push_back(t);
  return all;
}

void Attack::visit_state(optimize::StateVisitor& visit) {
  visit.tensors("object", object_tensors());
  moments_.visit(visit);
  visit.tensors("velocity", velocity_);
  visit_log(visit, "curves", curves_);
  visit_log(visit, "epochs", epochs_);
  if (epochs_.empty()) return;
  if (visit.reading()) {
    best_.tensors.clear();
    for (const Tensor& t : object_tensors()) best_.tensors.push_back(at::empty_like(t.detach()));
  }
  visit.tensors("best", best_.tensors);
  visit.number("best_success", best_.success);
  visit.integer("best_age", best_.age);
}

// ---- Steps --------------------------------------------------------------------------------

optimize::StepLoss Attack::compute(int64_t step) {
  std::vector<Tensor> parameters;
  for (const FreeParameter& p : free_parameters()) parameters.push_back(p.tensor);
  point_ = objects_[0]->compute(*appearance_, offsets_, step, parameters, grads_);
  if (objects_.size() > 1) add_other_objects(step, parameters);
  const double keep = curves_.empty() ? 0.0 : 0.95;
  shown_.success = keep * shown_.success + (1 - keep) * point_.success;
  shown_.objective = keep * shown_.objective + (1 - keep) * point_.objective;
  shown_.rgb = keep * shown_.rgb + (1 - keep) * point_.rgb;
  return {point_.loss,
          {{"loss", shown_.objective},
           {"asr", shown_.success},
           {"psnr", shown_.rgb > 0 ? -10 * std::log10(shown_.rgb) : 99.0}}};
}

/// Means over all objects of a universal attack.
void Attack::add_other_objects(int64_t step, const std::vector<Tensor>& parameters) {
  const double share = 1.0 / static_cast<double>(objects_.size());
  for (const auto& column : record::columns()) point_.*column.member *= share;
  for (Tensor& g : grads_) g = g * share;
  for (size_t i = 1; i < objects_.size(); ++i) {
    const scene::TriMesh& mesh = objects_[i]->input().object.mesh;
    std::vector<Tensor> grads;
    const record::CurvePoint point = objects_[i]->compute(
        *apply_to(*appearance_, mesh), at::zeros_like(mesh.vertices), step, parameters, grads);
    for (const auto& column : record::columns()) {
      point_.*column.member += share * point.*column.member;
    }
    for (size_t k = 0; k < grads.size(); ++k) grads_[k] = grads_[k] + grads[k] * share;
  }
}

void Attack::apply(int64_t step, double rate_scale) {
  const optimize::Adam adam{0.9, 0.999, 1e-15};
  const ScheduleOptions& schedule = options_.schedule;
  const double progress = static_cast<double>(step) / static_cast<double>(schedule.steps);
  const double decay = rate_share(schedule, progress) * rate_scale;
  const auto free = free_parameters();
  at::NoGradGuard guard;
  for (size_t i = 0; i < free.size(); ++i) {
    Tensor direction = grads_[i].contiguous();
    if (schedule.momentum > 0) direction = accelerate(velocity_[i], direction, schedule.momentum);
    adam.step(free[i].tensor, direction, moments_.first[i], moments_.second[i],
              free[i].rate * decay, step + 1);
  }
  grads_.clear();  // the next step takes their memory
  if (options_.naturalness.max_displacement > 0) {
    limit_offsets(offsets_, options_.naturalness.max_displacement);
  }
  appearance_->constrain();
  curves_.push_back(point_);
}

bool Attack::halve_batch() {
  if (objects_[0]->views() == 1) return false;
  for (const auto& object : objects_) object->halve_views();
  return true;
}

// ---- Epochs -------------------------------------------------------------------------------

void Attack::after_step(int64_t step) {
  const ScheduleOptions& schedule = options_.schedule;
  if (schedule.epoch > 0 && (step + 1) % schedule.epoch == 0) end_epoch(step + 1);
}

bool Attack::finished() const {
  return options_.schedule.patience > 0 && best_.age >= options_.schedule.patience;
}

double Attack::held_out_success() const {
  double sum = objects_[0]->held_out_success(*appearance_, offsets_);
  for (size_t i = 1; i < objects_.size(); ++i) {
    const scene::TriMesh& mesh = objects_[i]->input().object.mesh;
    sum +=
        objects_[i]->held_out_success(*apply_to(*appearance_, mesh), at::zeros_like(mesh.vertices));
  }
  return sum / static_cast<double>(objects_.size());
}

/// Adds the row of the epoch to the log and keeps the state if it is the best so far.
void Attack::end_epoch(int64_t steps) {
  record::Epoch epoch = {steps, 0, 0, held_out_success()};
  const auto length = static_cast<size_t>(options_.schedule.epoch);
  for (size_t i = curves_.size() - length; i < curves_.size(); ++i) {
    epoch.objective += curves_[i].objective / static_cast<double>(length);
    epoch.success += curves_[i].success / static_cast<double>(length);
  }
  epochs_.push_back(epoch);
  ++best_.age;
  // On a tie keep the later state; it has seen more views.
  if (epoch.held_out < best_.success) return;
  if (epoch.held_out > best_.success) best_.age = 0;
  best_.success = epoch.held_out;
  best_.tensors.clear();
  for (const Tensor& t : object_tensors()) best_.tensors.push_back(t.detach().clone());
}

AttackResult Attack::result() {
  at::NoGradGuard guard;
  const auto current = object_tensors();
  for (size_t i = 0; i < best_.tensors.size(); ++i) current[i].copy_(best_.tensors[i]);
  const scene::TriMesh& mesh = input_.object.mesh;
  return {
      {{(mesh.vertices + offsets_).detach(), mesh.faces}, appearance_->clone(), input_.object.map},
      curves_,
      epochs_};
}

// ---- Entry points -------------------------------------------------------------------------

AttackResult apply_appearance(const AttackResult& result, const AttackInput& other) {
  const scene::TriMesh& mesh = other.object.mesh;
  return {{mesh, apply_to(*result.object.appearance, mesh), other.object.map},
          result.curves,
          result.epochs};
}

AttackResult run_attack(const AttackInput& input, const AttackOptions& options, uint64_t seed,
                        const std::filesystem::path& checkpoint, Progress& progress) {
  const model::WeightsGuard weights(input.surrogates);
  Attack attack(input, options, seed);
  optimize::run_loop(
      attack,
      {"attack", options.schedule.steps, options.schedule.checkpoint_every, checkpoint,
       "lower attack.appearance_rate or attack.vertex_rate", "lower attack.image_size"},
      progress);
  weights.check();
  return attack.result();
}

void save_attack(const AttackResult& r, const std::filesystem::path& path) {
  object::save_object(r.object, path, {{"curves", log_tensor(r.curves)}}, "tt3d attack");
}

}  // namespace tt3d::attack
