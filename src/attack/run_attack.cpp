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

}  // namespace

AttackResult run_attack(const AttackInput& input, const AttackOptions& options, uint64_t seed,
                        const std::filesystem::path& checkpoint, Progress& progress) {
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
  result.appearance = s.appearance->clone();
  result.curves = s.curves;
  return result;
}

}  // namespace tt3d
