#pragma once

#include <memory>
#include <string>
#include <vector>

#include "graph.h"
#include "memory.h"

namespace tt3d::model {

/// A callback with the results of a run's layers, in order; its return value replaces the result.
class LayerTap {
 public:
  LayerTap() = default;
  LayerTap(const LayerTap&) = delete;
  LayerTap& operator=(const LayerTap&) = delete;
  virtual ~LayerTap() = default;
  /// `features`: the result of convolution or linear layer number `layer`, [N,C,...] or [N,...,C].
  virtual at::Tensor take(int64_t layer, const at::Tensor& features, bool channels_first) = 0;
};

/// Throws MemoryLimit if the operator of a node ran out of memory, else Malformed that names the
/// node.
[[noreturn]] void throw_node_error(const std::string& name, const std::string& target,
                                   const c10::Error& error);

/// Runs single steps of a graph on values by slot. It puts the constants of `graph` into `values`.
class StepRunner {
 public:
  StepRunner(const Graph& graph, at::Device device, std::vector<c10::IValue>& values,
             MemoryMeter& meter, LayerTap* tap = nullptr);
  ~StepRunner();
  /// Runs the step through the ATen dispatcher, stores its results, and drops the values that no
  /// later step reads. Throws as run_graph does.
  void run(const Step& step);

 private:
  class Run;
  std::unique_ptr<Run> run_;
};

/// Runs the steps of `graph` through the ATen dispatcher on normalised images [N,3,H,W], on any
/// device that holds the graph's constants. Gradients flow to the images if autograd is on. `tap`,
/// if not null, receives the results of all convolutions and linear layers but the last. Returns
/// logits [N,classes]. Throws Malformed that names the failing node, and MemoryLimit if the results
/// exceed `meter`'s limit or torch runs out of memory.
[[nodiscard]] at::Tensor run_graph(const Graph& graph, const at::Tensor& images, MemoryMeter& meter,
                                   LayerTap* tap = nullptr);

}  // namespace tt3d::model
