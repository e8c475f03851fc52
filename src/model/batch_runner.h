#pragma once

#include <ATen/core/Tensor.h>

#include <functional>
#include <memory>
#include <optional>

#include "graph.h"
#include "memory.h"
#include "tt3d/model.h"

namespace tt3d::model {

/// Runs a graph on batches of any size: fills up what is smaller than the exported range, and runs
/// in parts what is larger, or does not fit in memory. It remembers which sizes did not fit.
class BatchRunner : public std::enable_shared_from_this<BatchRunner> {
 public:
  BatchRunner(Graph graph, int64_t intermediate_bytes, Precision precision);

  /// images [N,3,H,W] float32, normalised, N > 0, on any device; logits [N,classes] float32,
  /// differentiable where autograd is on. Throws Malformed, and ResourceError where not even one
  /// image fits.
  [[nodiscard]] at::Tensor logits(const at::Tensor& images);
  [[nodiscard]] const Graph& graph() const { return graph_; }

  /// The product of `gradient` [N,classes] with the derivative of the logits: [N,3,H,W]. Runs
  /// forward and backward a part at a time, so that no more than one part's results are held.
  [[nodiscard]] at::Tensor gradient(const at::Tensor& images, const at::Tensor& gradient);

 private:
  using Part = std::function<at::Tensor(int64_t start, int64_t end)>;

  [[nodiscard]] at::Tensor whole(const at::Tensor& images);
  [[nodiscard]] at::Tensor in_parts(int64_t total, int64_t& fitting, const Part& part) const;
  [[nodiscard]] at::Tensor padded(const at::Tensor& images, MemoryMeter& meter);
  [[nodiscard]] at::Tensor run(const at::Tensor& images, MemoryMeter& meter);
  [[nodiscard]] const Graph& graph_on(at::Device device);

  Graph graph_;
  int64_t limit_;
  Precision precision_;
  /// Largest batches that are not known to be too large.
  int64_t fitting_, fitting_with_gradient_;
  std::optional<Graph> moved_;
  at::Device moved_device_ = at::kCPU;
};

}  // namespace tt3d::model
