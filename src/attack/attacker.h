#pragma once

#include <ATen/core/Tensor.h>

#include <vector>

#include "attack_state.h"
#include "ensemble.h"
#include "tt3d/attack.h"

namespace tt3d {

/// One attack on one object: what stays the same from step to step.
class Attacker {
 public:
  Attacker(const AttackInput& input, const AttackOptions& options, uint64_t seed);

  /// Views a step; fewer after halve_views.
  [[nodiscard]] int64_t views() const { return views_; }
  void halve_views() { views_ /= 2; }

  [[nodiscard]] AttackState fresh() const { return fresh_state(input_, options_); }
  /// Loss and gradients of a step, one a free parameter; the curve point has its parts.
  AttackCurvePoint compute(const AttackState& state, std::vector<at::Tensor>& grads) const;
  /// Moves the free parameters along the gradients.
  void apply(const std::vector<at::Tensor>& grads, AttackState& state) const;

 private:
  [[nodiscard]] at::Tensor render(const AttackState& state, const at::Tensor& vertices,
                                  at::Tensor& rgb, at::Tensor& missing) const;
  [[nodiscard]] at::Tensor missing_similarity(const at::Tensor& pictures,
                                              const at::Tensor& clean) const;

  const AttackInput& input_;
  const AttackOptions& options_;
  uint64_t seed_;
  int64_t views_;
  bool shape_is_free_;
  Ensemble ensemble_;
  RenderMesh prepared_;
  MeshRegularizer regularizer_;
  double rest_edge_ = 0;
};

}  // namespace tt3d
