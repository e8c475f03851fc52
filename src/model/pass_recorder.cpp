#include "pass_recorder.h"

#include <ATen/ATen.h>
#include <torch/csrc/autograd/autograd.h>
#include <torch/csrc/autograd/custom_function.h>

#ifdef TT3D_CUDA
#include <ATen/cuda/CUDAGraph.h>
#include <c10/cuda/CUDAFunctions.h>
#include <c10/cuda/CUDAGuard.h>
#endif

namespace tt3d::model {
namespace {

using at::Tensor;
using torch::autograd::AutogradContext;
using torch::autograd::variable_list;

/// The pass, and its turn() at the time of the forward pass.
struct HeldPass : torch::CustomClassHolder {
  HeldPass(std::shared_ptr<RecordedPass> held, int64_t its_turn)
      : pass(std::move(held)), turn(its_turn) {}
  std::shared_ptr<RecordedPass> pass;
  int64_t turn;
};

struct PlayedLogits : torch::autograd::Function<PlayedLogits> {
  static Tensor forward(AutogradContext* context, const Tensor& images,
                        const std::shared_ptr<RecordedPass>& pass) {
    context->save_for_backward({images});
    Tensor logits = pass->logits(images);
    context->saved_data["pass"] =
        c10::IValue::make_capsule(c10::make_intrusive<HeldPass>(pass, pass->turn()));
    return logits;
  }
  static variable_list backward(AutogradContext* context, const variable_list& gradients) {
    const auto holder = context->saved_data["pass"].toCapsule();
    const auto& held = static_cast<HeldPass&>(*holder);
    const Tensor images = context->get_saved_variables()[0];
    if (held.pass->turn() != held.turn) static_cast<void>(held.pass->logits(images));
    return {held.pass->gradient(gradients[0]), Tensor()};
  }
};

}  // namespace

RecordedPass::RecordedPass(std::unique_ptr<Recorder> recorder, const Forward& forward,
                           const Tensor& like)
    : images_(at::empty_like(like.detach()).copy_(like.detach())), recorder_(std::move(recorder)) {
  images_.requires_grad_(true);
  const at::AutoGradMode with_gradients(true);
  const auto ahead = [&, forward] { logits_ = forward(images_); };
  const auto back = [&] {
    images_gradient_ = torch::autograd::grad({logits_}, {images_}, {gradient_})[0];
  };
  recorder_->warm_up([&] {
    ahead();
    gradient_ = at::zeros_like(logits_.detach());
    back();
  });
  forward_ = recorder_->make();
  forward_->record(ahead);
  backward_ = recorder_->make();
  backward_->record(back);
}

Tensor RecordedPass::logits(const Tensor& images) {
  {
    const at::NoGradGuard none;
    images_.copy_(images);
  }
  forward_->play();
  ++turn_;
  return logits_.detach().clone();
}

Tensor RecordedPass::gradient(const Tensor& gradient) {
  gradient_.copy_(gradient);
  backward_->play();
  return images_gradient_.clone();
}

Tensor played_logits(const std::shared_ptr<RecordedPass>& pass, const Tensor& images) {
  return PlayedLogits::apply(images, pass);
}

#ifdef TT3D_CUDA

namespace {

class CudaGraphRecording final : public Recording {
 public:
  CudaGraphRecording(const c10::cuda::CUDAStream& stream, c10::MempoolId_t pool)
      : stream_(stream), pool_(pool) {}

  void record(const std::function<void()>& work) override {
    c10::cuda::device_synchronize();
    const c10::cuda::CUDAStreamGuard guard(stream_);
    graph_.capture_begin(pool_);
    try {
      work();
    } catch (...) {
      try {
        graph_.capture_end();  // ends the stream's capture; its own failure adds no information
      } catch (const c10::Error&) {
      }
      throw;
    }
    graph_.capture_end();
  }
  void play() override { graph_.replay(); }

 private:
  c10::cuda::CUDAStream stream_;
  c10::MempoolId_t pool_;
  at::cuda::CUDAGraph graph_;
};

/// Records on a separate stream, which capture requires; replays on torch's current one.
class CudaGraphRecorder final : public Recorder {
 public:
  explicit CudaGraphRecorder(at::Device device)
      : stream_(c10::cuda::getStreamFromPool(false, device.index())),
        pool_(at::cuda::graph_pool_handle()) {}

  void warm_up(const std::function<void()>& work) override {
    constexpr int kRounds = 3;  // as in torch's make_graphed_callables
    c10::cuda::device_synchronize();
    {
      const c10::cuda::CUDAStreamGuard guard(stream_);
      for (int round = 0; round < kRounds; ++round) work();
    }
    c10::cuda::device_synchronize();
  }
  std::unique_ptr<Recording> make() override {
    return std::make_unique<CudaGraphRecording>(stream_, pool_);
  }

 private:
  c10::cuda::CUDAStream stream_;
  c10::MempoolId_t pool_;
};

}  // namespace

std::unique_ptr<Recorder> cuda_graph_recorder(at::Device device) {
  return std::make_unique<CudaGraphRecorder>(device);
}

#else

std::unique_ptr<Recorder> cuda_graph_recorder(at::Device /*device*/) { return nullptr; }

#endif

}  // namespace tt3d::model
