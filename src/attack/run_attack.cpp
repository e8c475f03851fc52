#include <ATen/ATen.h>

#include <cmath>

#include "attacker.h"

namespace tt3d {
namespace {

using at::Tensor;

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

/// Closes an epoch: its row of the log, and the best state so far.
void end_epoch(const Attacker& attacker, const AttackOptions& options, AttackState& s) {
  AttackEpoch epoch = {s.step, 0, 0, attacker.held_out_success(s)};
  const auto length = static_cast<size_t>(options.epoch);
  for (size_t i = s.curves.size() - length; i < s.curves.size(); ++i) {
    epoch.objective += s.curves[i].objective / static_cast<double>(length);
    epoch.success += s.curves[i].success / static_cast<double>(length);
  }
  s.epochs.push_back(epoch);
  ++s.best.age;
  // Of equals the later one, which saw more.
  if (epoch.held_out < s.best.success) return;
  if (epoch.held_out > s.best.success) s.best.age = 0;
  s.best.success = epoch.held_out;
  s.best.tensors.clear();
  for (const Tensor& t : object_tensors(s)) s.best.tensors.push_back(t.detach().clone());
}

bool ran_out_of_patience(const AttackOptions& options, const AttackState& s) {
  return options.patience > 0 && s.best.age >= options.patience;
}

void restore_best(AttackState& s) {
  at::NoGradGuard guard;
  const auto current = object_tensors(s);
  for (size_t i = 0; i < s.best.tensors.size(); ++i) current[i].copy_(s.best.tensors[i]);
}

}  // namespace

AttackResult worn_result(const AttackResult& result, const AttackInput& other) {
  auto look = result.appearance->worn_by(other.mesh);
  if (!look) {
    throw InputError("attack.also: this look fits its own object alone; take a triplanar tile");
  }
  return {other.mesh, std::move(look), result.curves, result.epochs};
}

AttackResult run_attack(const AttackInput& input, const AttackOptions& options, uint64_t seed,
                        const std::filesystem::path& checkpoint, Progress& progress) {
  Attacker attacker(input, options, seed);
  AttackState s = attacker.fresh();
  if (std::filesystem::exists(checkpoint)) load_state(checkpoint, s);
  progress.begin("attack", options.steps, s.step);
  double success = 0, objective = 0, rgb = 0;
  while (s.step < options.steps && !ran_out_of_patience(options, s)) {
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
    if (options.epoch > 0 && s.step % options.epoch == 0) end_epoch(attacker, options, s);
    if (s.step % options.checkpoint_every == 0) save_state(s, checkpoint);
    progress.check();
  }
  progress.end();
  restore_best(s);
  AttackResult result;
  result.mesh = {(input.mesh.vertices + s.offsets).detach(), input.mesh.faces};
  result.appearance = s.appearance->clone();
  result.curves = s.curves;
  result.epochs = s.epochs;
  return result;
}

}  // namespace tt3d
