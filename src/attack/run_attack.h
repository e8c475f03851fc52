#pragma once

#include <ATen/core/Tensor.h>

#include <memory>
#include <vector>

#include "object_terms.h"
#include "tt3d/attack.h"
#include "tt3d/optimize.h"

namespace tt3d::attack {

/// Factor on the learning rates after `progress` (0 to 1) of the steps.
[[nodiscard]] double rate_share(const ScheduleOptions& options, double progress);

/// The attack on one or several objects: its steps, and the state that a checkpoint holds.
class Attack final : public optimize::Optimization {
 public:
  Attack(const AttackInput& input, const AttackOptions& options, uint64_t seed);
  ~Attack() override;

  void restart() override;
  void visit_state(optimize::StateVisitor& visit) override;
  optimize::StepLoss compute(int64_t step) override;
  void apply(int64_t step, double rate_scale) override;
  void after_step(int64_t step) override;
  [[nodiscard]] bool finished() const override;
  bool halve_batch() override;
  /// The last state or, with attack.epoch, the best one.
  [[nodiscard]] AttackResult result();

  /// The parameters that attack.optimize names, vertex offsets first.
  [[nodiscard]] std::vector<FreeParameter> free_parameters() const;
  /// Gradients of the last step, one per free parameter.
  [[nodiscard]] std::vector<at::Tensor>& gradients() { return grads_; }
  /// Momentum of the gradients, if attack.momentum is not 0.
  [[nodiscard]] const std::vector<at::Tensor>& velocity() const { return velocity_; }

 private:
  /// The state with the highest success on held-out views so far.
  struct Best {
    std::vector<at::Tensor> tensors;  ///< in the order of object_tensors; empty: none yet
    double success = -1;
    int64_t age = 0;  ///< epochs since it was reached
  };

  [[nodiscard]] std::vector<at::Tensor> object_tensors() const;
  void add_other_objects(int64_t step, const std::vector<at::Tensor>& parameters);
  void end_epoch(int64_t steps);
  [[nodiscard]] double held_out_success() const;

  const AttackInput& input_;
  const AttackOptions& options_;
  std::vector<std::unique_ptr<ObjectTerms>> objects_;
  // State.
  at::Tensor offsets_;  ///< [V,3]
  std::unique_ptr<object::Appearance> appearance_;
  optimize::AdamMoments moments_;     ///< in the order of free_parameters
  std::vector<at::Tensor> velocity_;  ///< the same order; empty if attack.momentum is 0
  record::Curves curves_;
  std::vector<record::Epoch> epochs_;
  Best best_;
  // Of the last step.
  std::vector<at::Tensor> grads_;
  record::CurvePoint point_;
  record::CurvePoint shown_;  ///< running means for the progress line
};

}  // namespace tt3d::attack
