#pragma once

#include "graph.h"
#include "memory.h"

namespace tt3d::model {

/// Runs the steps of `graph` on normalised images [N,3,H,W] (any device that holds the graph's
/// constants) through the ATen dispatcher; gradients flow to the images where autograd is on.
/// Returns logits [N,classes]. Throws Malformed naming the node an operator fails at, and
/// MemoryLimit where the results pass `meter`'s limit or torch runs out of memory.
[[nodiscard]] at::Tensor run_graph(const Graph& graph, const at::Tensor& images,
                                   MemoryMeter& meter);

}  // namespace tt3d::model
