#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <functional>
#include <memory>

namespace tt3d::model {

/// Work on the GPU that is recorded once and replayed: one launch instead of hundreds.
class Recording {
 public:
  virtual ~Recording() = default;
  /// Records `work`, which may access only memory at fixed addresses. Recording does not
  /// necessarily execute it. Throws what `work` throws, and c10::Error for work that cannot be
  /// recorded.
  virtual void record(const std::function<void()>& work) = 0;
  virtual void play() = 0;
};

/// Makes the recordings of one classifier.
class Recorder {
 public:
  virtual ~Recorder() = default;
  /// Runs `work` in the same way as record(), but unrecorded, so that libraries can initialise.
  virtual void warm_up(const std::function<void()>& work) = 0;
  /// A new recording; it must play after the earlier ones, whose memory it shares.
  virtual std::unique_ptr<Recording> make() = 0;
};

/// The recorder of CUDA graphs; null in a build without CUDA.
[[nodiscard]] std::unique_ptr<Recorder> cuda_graph_recorder(at::Device device);

/// Forward and backward pass of a batch, recorded for one shape.
class RecordedPass {
 public:
  using Forward = std::function<at::Tensor(const at::Tensor& images)>;
  /// Records `forward` and its gradient for images of the shape of `like`.
  RecordedPass(std::unique_ptr<Recorder> recorder, const Forward& forward, const at::Tensor& like);
  RecordedPass(const RecordedPass&) = delete;  // recordings hold addresses of its members
  RecordedPass& operator=(const RecordedPass&) = delete;

  /// Logits of `images`, in a new tensor.
  [[nodiscard]] at::Tensor logits(const at::Tensor& images);
  /// The product of `gradient` [N,classes] with the derivative of the latest logits().
  [[nodiscard]] at::Tensor gradient(const at::Tensor& gradient);
  /// Number of logits() calls so far. Memory holds the intermediate results of the latest call.
  [[nodiscard]] int64_t turn() const { return turn_; }

 private:
  at::Tensor images_, logits_, gradient_, images_gradient_;  ///< fixed memory of the recordings
  std::unique_ptr<Recorder> recorder_;                       ///< owns the recordings' memory pool
  std::unique_ptr<Recording> forward_, backward_;
  int64_t turn_ = 0;
};

/// The pass as a differentiable function of the images. Backward passes may come in any order: if
/// other images went through the pass since, the forward pass is replayed first.
[[nodiscard]] at::Tensor played_logits(const std::shared_ptr<RecordedPass>& pass,
                                       const at::Tensor& images);

}  // namespace tt3d::model
