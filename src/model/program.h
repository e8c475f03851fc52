#pragma once

#include "graph.h"

namespace tt3d::model {

/// Intermediate results passed the limit; a smaller batch may fit.
class MemoryLimit : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Runs the steps of `graph` on normalised images [N,3,H,W] (any device that holds the graph's
/// constants) through the ATen dispatcher; gradients flow to the images where autograd is on.
/// Returns logits [N,classes]. Throws Malformed naming the node an operator fails at, and
/// MemoryLimit past `intermediate_bytes`.
[[nodiscard]] at::Tensor run_graph(const Graph& graph, const at::Tensor& images,
                                   int64_t intermediate_bytes);

}  // namespace tt3d::model
