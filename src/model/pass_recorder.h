#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <functional>
#include <memory>

namespace tt3d::model {

/// Work on the GPU that is recorded once and played again: one launch in the place of hundreds.
class Recording {
 public:
  virtual ~Recording() = default;
  /// Records `work`, which may read and write only memory that stays where it is. The work itself
  /// may not run. Throws what `work` throws, and c10::Error for what cannot be recorded.
  virtual void record(const std::function<void()>& work) = 0;
  virtual void play() = 0;
};

/// How the passes of one classifier are recorded.
class Recorder {
 public:
  virtual ~Recorder() = default;
  /// Runs `work` as recordings do, unrecorded: libraries set themselves up on the way.
  virtual void warm_up(const std::function<void()>& work) = 0;
  /// A recording that follows those made before it and shares their memory.
  virtual std::unique_ptr<Recording> make() = 0;
};

/// CUDA graphs (Recorder's only maker in a build with CUDA; null in one without).
[[nodiscard]] std::unique_ptr<Recorder> cuda_graph_recorder(at::Device device);

/// A batch's way through a network and back, recorded for one shape.
class RecordedPass {
 public:
  using Forward = std::function<at::Tensor(const at::Tensor& images)>;
  /// Records `forward` and its gradient for images of the shape of `like`.
  RecordedPass(std::unique_ptr<Recorder> recorder, const Forward& forward, const at::Tensor& like);
  RecordedPass(const RecordedPass&) = delete;  // the recordings know where it lies
  RecordedPass& operator=(const RecordedPass&) = delete;

  /// Logits of `images`, a tensor of its own.
  [[nodiscard]] at::Tensor logits(const at::Tensor& images);
  /// The product of `gradient` [N,classes] with the derivative of the newest logits().
  [[nodiscard]] at::Tensor gradient(const at::Tensor& gradient);
  /// Counts logits(): what backward finds in memory belongs to the newest.
  [[nodiscard]] int64_t turn() const { return turn_; }

 private:
  at::Tensor images_, logits_, gradient_, images_gradient_;  ///< where the recordings work
  std::unique_ptr<Recorder> recorder_;                       ///< keeps the recordings' memory
  std::unique_ptr<Recording> forward_, backward_;
  int64_t turn_ = 0;
};

/// The pass as a differentiable function of the images. Results may be used in any order: backward
/// plays forward again where other images came through since.
[[nodiscard]] at::Tensor played_logits(const std::shared_ptr<RecordedPass>& pass,
                                       const at::Tensor& images);

}  // namespace tt3d::model
