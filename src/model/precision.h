#pragma once

#include <ATen/core/Tensor.h>

#include "graph.h"
#include "tt3d/model.h"

namespace tt3d::model {

/// Throws InputError if `precision` is slower than float32 here, or not available.
void check_precision(Precision precision);

/// Stores the weights of convolutions and linear layers in bfloat16, so that runs need not convert
/// them.
void use_bfloat16_weights(Graph& graph);

/// In its scope, operators run in `precision`. For bfloat16 that is torch's autocast: it converts
/// the arguments of convolutions and matrix products, and keeps sums and norms in float32.
class PrecisionScope {
 public:
  PrecisionScope(Precision precision, at::Device device);
  ~PrecisionScope();
  PrecisionScope(const PrecisionScope&) = delete;
  PrecisionScope& operator=(const PrecisionScope&) = delete;

 private:
  at::DeviceType device_;
  bool active_, enabled_ = false, cached_ = false;
  at::ScalarType type_ = at::kFloat;
};

}  // namespace tt3d::model
