#include <ATen/ATen.h>

#include "tt3d/attack.h"

namespace tt3d::attack {

using at::Tensor;

namespace {

/// The targeted loss, averaged over pictures: small if the model chooses the class.
Tensor towards(Objective objective, const Tensor& logits, int64_t index) {
  const Tensor wanted = logits.select(1, index);
  if (objective == Objective::kCrossEntropy) return (logits.logsumexp(1) - wanted).mean();
  // Zhao et al., "On success and simplicity: a second look at transferable targeted attacks", 2021:
  // the gradient of cross-entropy vanishes, the gradient of the logit does not.
  if (objective == Objective::kLogit) return -wanted.mean();
  // Carlini & Wagner 2017, without their bound on the confidence.
  Tensor others = logits.clone();
  others.select(1, index).fill_(-1e9);
  return (others.logsumexp(1) - wanted).mean();
}

}  // namespace

Tensor objective_loss(Objective objective, Goal goal, const Tensor& logits, int64_t index) {
  Tensor loss = towards(objective, logits, index);
  return goal == Goal::kTargeted ? loss : -loss;
}

}  // namespace tt3d::attack
