#pragma once

#include <ATen/core/Tensor.h>

#include <memory>
#include <vector>

#include "attack_state.h"
#include "ensemble.h"
#include "naturalness.h"
#include "tt3d/attack.h"

namespace tt3d {

/// Share of the learning rates that is left after `progress` (0 to 1) of the steps.
[[nodiscard]] double rate_share(const AttackOptions& options, double progress);

/// One attack on one object: what stays the same from step to step.
class Attacker {
 public:
  Attacker(const AttackInput& input, const AttackOptions& options, uint64_t seed);

  /// Views a step; fewer after halve_views.
  [[nodiscard]] int64_t views() const { return views_; }
  void halve_views();

  [[nodiscard]] AttackState fresh() const { return fresh_state(input_, options_); }
  /// Loss and gradients of a step, one a free parameter; the curve point has its parts. In a
  /// universal attack, means over the objects.
  AttackCurvePoint compute(const AttackState& state, std::vector<at::Tensor>& grads) const;
  /// Success on held-out views on white, as each surrogate's users would show them: what evaluation
  /// measures, by views of another stream.
  [[nodiscard]] double held_out_success(const AttackState& state) const;
  /// Moves the free parameters along the gradients.
  void apply(const std::vector<at::Tensor>& grads, AttackState& state) const;

 private:
  AttackCurvePoint compute_own(const AttackState& state, std::vector<at::Tensor>& grads) const;
  /// The state of this object in the other one's attack: its look, and the shape as it is.
  [[nodiscard]] AttackState wearing(const AttackState& state) const;
  [[nodiscard]] std::vector<Camera> cameras(int64_t step) const;
  [[nodiscard]] at::Tensor competitors(const Rendering& shown) const;
  [[nodiscard]] Rendering render(const AttackState& state, const at::Tensor& vertices) const;

  const AttackInput& input_;
  const AttackOptions& options_;
  uint64_t seed_;
  int64_t views_;
  Ensemble ensemble_;
  Naturalness naturalness_;
  RenderMesh prepared_;
  std::vector<std::unique_ptr<Attacker>> also_;
};

}  // namespace tt3d
