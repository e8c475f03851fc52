#include <ATen/ATen.h>

#include "tt3d/attack.h"

namespace tt3d {

using at::Tensor;

const std::vector<std::string>& objective_names() {
  static const std::vector<std::string> names = {"cross-entropy", "logit", "margin"};
  return names;
}

Tensor objective_loss(const std::string& name, const Tensor& logits, int64_t target) {
  const Tensor wanted = logits.select(1, target);
  if (name == "cross-entropy") return (logits.logsumexp(1) - wanted).mean();
  // Zhao et al., "On success and simplicity: a second look at transferable targeted attacks",
  // 2021: the bare logit keeps its gradient when cross-entropy has none left.
  if (name == "logit") return -wanted.mean();
  // Carlini & Wagner 2017, without a bound on confidence.
  Tensor others = logits.clone();
  others.select(1, target).fill_(-1e9);
  if (name == "margin") return (others.logsumexp(1) - wanted).mean();
  throw InputError("attack.objective: unknown '" + name +
                   "', expected cross-entropy, logit or margin");
}

}  // namespace tt3d
