#pragma once

#include <ATen/core/Tensor.h>

#include <map>

#include "program.h"
#include "tt3d/model.h"

namespace tt3d::model {

/// Keeps what the chosen layers make of the competitors in a first run, and mixes it into what they
/// make of the pictures in a second one.
class FeatureMixer : public LayerTap {
 public:
  /// For pictures [first, first + n) of the batch that `mix` is about.
  FeatureMixer(const FeatureMix& mix, int64_t first);

  /// The competitors have run.
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
