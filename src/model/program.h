#pragma once

#include "graph.h"
#include "memory.h"

namespace tt3d::model {

/// Told what the layers of a run give, in order; what it returns goes on in their place.
class LayerTap {
 public:
  LayerTap() = default;
  LayerTap(const LayerTap&) = delete;
  LayerTap& operator=(const LayerTap&) = delete;
  virtual ~LayerTap() = default;
  /// `features` of convolution or linear layer number `layer`: [N,C,...] or [N,...,C].
  virtual at::Tensor take(int64_t layer, const at::Tensor& features, bool channels_first) = 0;
};

/// Runs the steps of `graph` on normalised images [N,3,H,W] (any device that holds the graph's
/// constants) through the ATen dispatcher; gradients flow to the images where autograd is on.
/// `tap`, if any, takes what convolutions and linear layers give, the last one aside. Returns
/// logits [N,classes]. Throws Malformed naming the node an operator fails at, and MemoryLimit where
/// the results pass `meter`'s limit or torch runs out of memory.
[[nodiscard]] at::Tensor run_graph(const Graph& graph, const at::Tensor& images, MemoryMeter& meter,
                                   LayerTap* tap = nullptr);

}  // namespace tt3d::model
