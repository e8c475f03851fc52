#pragma once

#include <ATen/core/Tensor.h>

#include <functional>
#include <map>
#include <memory>
#include <optional>

#include "graph.h"
#include "memory.h"
#include "pass_recorder.h"
#include "plan.h"
#include "tt3d/model.h"

namespace tt3d::model {

/// Normalised images [N,3,H,W], and their competitors if features are mixed.
struct Pictures {
  at::Tensor images;
  std::optional<FeatureMix> mix = {};  ///< of the whole batch; its images are normalised too
  int64_t first = 0;                   ///< index of the first image within that batch

  [[nodiscard]] Pictures slice(int64_t start, int64_t end) const {
    return {images.slice(0, start, end), mix, first + start};
  }
};

/// Runs a graph on batches of any size. Smaller batches than exported are padded. Larger ones, or
/// ones that do not fit in memory, run in parts. It remembers which sizes did not fit.
class BatchRunner : public std::enable_shared_from_this<BatchRunner> {
 public:
  /// `compile`: runs on the CPU use a plan, if the graph has one.
  BatchRunner(Graph graph, int64_t intermediate_bytes, Precision precision, bool compile);

  /// float32, N > 0, on any device; logits [N,classes] float32, differentiable if autograd is on.
  /// Throws Malformed, and ResourceError if not even one image fits.
  [[nodiscard]] at::Tensor logits(const Pictures& pictures);
  [[nodiscard]] const Graph& graph() const { return graph_; }
  [[nodiscard]] const Plan* plan() const { return plan_.get(); }
  /// The graph of the last pass: on a GPU the copy there.
  [[nodiscard]] const Graph& used_graph() const { return moved_ ? *moved_ : graph_; }

  /// The product of `gradient` [N,classes] with the derivative of the logits: [N,3,H,W]. Runs
  /// forward and backward part by part, so that memory holds one part's results only.
  [[nodiscard]] at::Tensor gradient(const Pictures& pictures, const at::Tensor& gradient);

 private:
  using Part = std::function<at::Tensor(int64_t start, int64_t end)>;

  [[nodiscard]] at::Tensor whole(const Pictures& pictures);
  [[nodiscard]] bool is_recorded(const Pictures& pictures) const;
  [[nodiscard]] std::shared_ptr<RecordedPass> recorded_pass(const at::Tensor& images);
  [[nodiscard]] at::Tensor in_parts(int64_t total, int64_t& fitting, const Part& part) const;
  [[nodiscard]] at::Tensor filled_up(const at::Tensor& images) const;
  [[nodiscard]] at::Tensor run(const Pictures& pictures, MemoryMeter& meter);
  [[nodiscard]] at::Tensor raw_logits(const Pictures& pictures, const at::Tensor& images,
                                      MemoryMeter& meter);
  [[nodiscard]] const Graph& graph_on(at::Device device);

  Graph graph_;
  std::shared_ptr<const Plan> plan_;
  int64_t limit_;
  Precision precision_;
  /// The largest batches that may still fit.
  int64_t fitting_, fitting_with_gradient_;
  std::optional<Graph> moved_;
  at::Device moved_device_ = at::kCPU;
  std::map<int64_t, std::shared_ptr<RecordedPass>> passes_;  ///< by batch size, on moved_device_
};

}  // namespace tt3d::model
