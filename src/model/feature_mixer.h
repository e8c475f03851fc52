#pragma once

#include <ATen/core/Tensor.h>

#include <map>

#include "program.h"
#include "tt3d/model.h"

namespace tt3d::model {

/// Feature mixing in two runs: the first one keeps the competitors' features at the chosen layers,
/// the second one mixes them into the features of the pictures.
class FeatureMixer : public LayerTap {
 public:
  /// For pictures [first, first + n) of the batch that `mix` describes.
  FeatureMixer(const FeatureMix& mix, int64_t first);

  /// Call it after the run of the competitors.
  void begin_mixing() { mixing_ = true; }
  at::Tensor take(int64_t layer, const at::Tensor& features, bool channels_first) override;

 private:
  void keep(int64_t layer, const at::Tensor& features);

  const FeatureMix& mix_;
  int64_t first_;
  Random choice_;
  std::map<int64_t, at::Tensor> kept_;
  bool mixing_ = false;
};

}  // namespace tt3d::model
