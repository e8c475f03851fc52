#include "ensemble.h"

#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>

#include <algorithm>

namespace tt3d::attack {

using at::Tensor;

namespace {

void check_classes(const AttackInput& input) {
  if (input.classes.size() != input.surrogates.size()) {
    throw InputError("attack.surrogates: expected one class per surrogate");
  }
}

/// Throws InputError if the surrogates have different labels: their logits then have no mean.
void check_same_labels(const AttackInput& input) {
  const model::ModelCard& first = input.surrogates[0]->card();
  for (size_t m = 1; m < input.surrogates.size(); ++m) {
    const model::ModelCard& card = input.surrogates[m]->card();
    if (card.labels == first.labels && input.classes[m] == input.classes[0]) continue;
    throw InputError(
        "attack.ensemble: the mean of logits needs surrogates with the same labels, but " +
        first.name + " and " + card.name + " have different ones; choose losses or gradients");
  }
}

}  // namespace

Tensor with_gradient_of_length(const Tensor& x, double length) {
  if (!x.requires_grad()) return x;
  Tensor same = x.view_as(x);
  same.register_hook(
      [length](const Tensor& grad) { return grad * (length / grad.norm().clamp_min(1e-30)); });
  return same;
}

Ensemble::Ensemble(const AttackInput& input, const AttackOptions& options, uint64_t seed)
    : input_(input), options_(options), seed_(seed) {
  if (input.surrogates.empty()) throw InputError("attack.surrogates: name at least one model");
  check_classes(input);
  if (options.objective.ensemble == EnsembleMode::kLogits) check_same_labels(input);
  if (!options.eot.photographs.empty()) photographs_.emplace(options.eot.photographs.string());
  const bool wanted = options.eot.photograph_background > 0 || options.eot.mix > 0;
  if (wanted && !photographs_) {
    throw InputError(
        "attack.eot.photographs: expected a folder, because photograph_background or mix is not 0");
  }
}

Tensor Ensemble::loss(const Tensor& pictures, const Tensor& clean, int64_t step,
                      std::vector<Tensor>& hits) const {
  if (options_.objective.ensemble == EnsembleMode::kViews)
    return loss_of_shared_views(pictures, clean, step, hits);
  const size_t models = input_.surrogates.size();
  const auto count = static_cast<int64_t>(models);
  Tensor total = at::zeros({}, pictures.options());
  if (options_.objective.ensemble == EnsembleMode::kLogits) {
    // Dong et al., "Boosting adversarial attacks with momentum", CVPR 2018, section 3.4.
    Tensor sum = logits(0, pictures, clean, step * count, hits);
    for (size_t m = 1; m < models; ++m) {
      sum = sum + logits(m, pictures, clean, step * count, hits);
    }
    return objective(sum / static_cast<double>(models), 0);
  }
  const bool of_gradients = options_.objective.ensemble == EnsembleMode::kGradients;
  const double share = 1.0 / static_cast<double>(models);
  for (size_t m = 0; m < models; ++m) {
    const Tensor own = of_gradients ? with_gradient_of_length(pictures, share) : pictures;
    const int64_t draw = step * count + static_cast<int64_t>(m);
    total = total + objective(logits(m, own, clean, draw, hits), m);
  }
  return total / static_cast<double>(models);
}

Tensor Ensemble::loss_of_shared_views(const Tensor& pictures, const Tensor& clean, int64_t step,
                                      std::vector<Tensor>& hits) const {
  const auto models = static_cast<int64_t>(input_.surrogates.size());
  const int64_t views = pictures.size(0);
  Tensor total = at::zeros({}, pictures.options());
  for (int64_t view = 0; view < std::min(models, views); ++view) {
    // Count over all steps, so that every model gets views even if a step has fewer views than
    // there are models.
    const int64_t m = (step * views + view) % models;
    const auto share = [&](const Tensor& t) { return t.slice(0, view, views, models); };
    const Tensor own = share(pictures);
    const Tensor answer = logits(static_cast<size_t>(m), own,
                                 clean.defined() ? share(clean) : clean, step * models + m, hits);
    total = total + objective(answer, static_cast<size_t>(m)) * static_cast<double>(own.size(0));
  }
  return total / static_cast<double>(views);
}

Tensor Ensemble::transformed(size_t model, const Tensor& pictures, uint64_t seed,
                             int64_t draw) const {
  return transform_images(pictures, input_.surrogates[model]->card().height, options_.eot, seed,
                          draw, photographs_ ? &*photographs_ : nullptr);
}

Tensor Ensemble::logits(size_t model, const Tensor& pictures, const Tensor& clean, int64_t draw,
                        std::vector<Tensor>& hits) const {
  const model::Classifier& surrogate = *input_.surrogates[model];
  const Tensor seen = transformed(model, pictures, seed_, draw);
  Tensor answer;
  if (options_.objective.feature_mix > 0) {
    const Tensor competitor = transformed(model, clean, seed_ ^ hash_name("attack/clean"), draw);
    answer = surrogate.mixed_logits(
        seen, {competitor, options_.objective.feature_mix, options_.objective.feature_mix_share,
               seed_, static_cast<uint64_t>(draw)});
  } else {
    answer = surrogate.logits(seen);
  }
  hits.push_back(success_share(model, answer));
  return answer;
}

Tensor Ensemble::success_share(size_t model, const Tensor& logits) const {
  const Tensor taken = logits.detach().argmax(1) == input_.classes[model];
  return (options_.objective.goal == Goal::kUntargeted ? ~taken : taken).to(at::kDouble).mean();
}

double Ensemble::success(const Tensor& pictures) const {
  at::NoGradGuard guard;
  double sum = 0;
  for (size_t m = 0; m < input_.surrogates.size(); ++m) {
    const model::Classifier& model = *input_.surrogates[m];
    sum += success_share(m, model.logits(model::preprocess(pictures, model.card()))).item<double>();
  }
  return sum / static_cast<double>(input_.surrogates.size());
}

Tensor Ensemble::objective(const Tensor& logits, size_t model) const {
  return objective_loss(options_.objective.loss, options_.objective.goal, logits,
                        input_.classes[model]);
}

}  // namespace tt3d::attack
