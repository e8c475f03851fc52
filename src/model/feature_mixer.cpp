#include "feature_mixer.h"

#include <ATen/ATen.h>

#include "tt3d/random_tensor.h"

namespace tt3d::model {

FeatureMixer::FeatureMixer(const FeatureMix& mix, int64_t first)
    : mix_(mix), first_(first), choice_(mix.seed, "model/mix/layers", mix.step) {}

void FeatureMixer::keep(int64_t layer, const at::Tensor& features) {
  // Every layer draws, whether or not it mixes, so the draws of one do not depend on the others.
  // The features are copied, because the following activation may work in place.
  if (choice_.uniform() < mix_.probability) kept_[layer] = features.clone();
}

at::Tensor FeatureMixer::take(int64_t layer, const at::Tensor& features, bool channels_first) {
  if (!mixing_) {
    keep(layer, features);
    return features;
  }
  const auto kept = kept_.find(layer);
  if (kept == kept_.end()) return features;
  const int64_t axis = channels_first ? 1 : features.dim() - 1;
  std::vector<int64_t> shape(static_cast<size_t>(features.dim()), 1);
  shape[0] = mix_.images.size(0);
  shape[static_cast<size_t>(axis)] = features.size(axis);
  const Random draws(mix_.seed, "model/mix/" + std::to_string(layer), mix_.step);
  // Drawn for the whole batch, so that a batch in parts gets the same numbers.
  const at::Tensor shares =
      uniform_tensor(shape, 0, mix_.share, draws.key(), features.device()).to(features.dtype());
  const int64_t most = std::min(first_ + features.size(0), shape[0]);
  at::Tensor own = shares.slice(0, first_, most);
  if (own.size(0) < features.size(0)) {  // the batch is padded with zeros
    std::vector<int64_t> missing = shape;
    missing[0] = features.size(0) - own.size(0);
    own = at::cat({own, at::zeros(missing, own.options())});
  }
  return features + own * (kept->second - features);
}

}  // namespace tt3d::model
