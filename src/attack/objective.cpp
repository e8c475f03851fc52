#include <ATen/ATen.h>

#include "tt3d/attack.h"

namespace tt3d {

using at::Tensor;

namespace {

/// Small where the class is chosen; a mean over pictures.
Tensor towards(const std::string& name, const Tensor& logits, int64_t index) {
  const Tensor wanted = logits.select(1, index);
  if (name == "cross-entropy") return (logits.logsumexp(1) - wanted).mean();
  // Zhao et al., "On success and simplicity: a second look at transferable targeted attacks",
  // 2021: the bare logit keeps its gradient when cross-entropy has none left.
  if (name == "logit") return -wanted.mean();
  // Carlini & Wagner 2017, without a bound on confidence.
  Tensor others = logits.clone();
  others.select(1, index).fill_(-1e9);
  if (name == "margin") return (others.logsumexp(1) - wanted).mean();
  throw InputError("attack.objective: unknown '" + name +
                   "', expected cross-entropy, logit or margin");
}

}  // namespace

const std::vector<std::string>& objective_names() {
  static const std::vector<std::string> names = {"cross-entropy", "logit", "margin"};
  return names;
}

const std::vector<std::string>& goal_names() {
  static const std::vector<std::string> names = {"targeted", "untargeted"};
  return names;
}

Tensor objective_loss(const std::string& name, const std::string& goal, const Tensor& logits,
                      int64_t index) {
  const Tensor loss = towards(name, logits, index);
  if (goal == "targeted") return loss;
  if (goal == "untargeted") return -loss;
  throw InputError("attack.goal: unknown '" + goal + "', expected targeted or untargeted");
}

}  // namespace tt3d
