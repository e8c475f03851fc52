// A classifier's recorded pass, with a recorder for the CPU. tests/gpu checks that CUDA graphs
// behave like this recorder.

#include "model/pass_recorder.h"

#include <ATen/ATen.h>
#include <gtest/gtest.h>
#include <torch/csrc/autograd/autograd.h>

#include "support/shapes.h"

namespace tt3d::model {
namespace {

using at::Tensor;

/// A recording that plays by running the work again, on the same memory.
struct Again final : Recording {
  explicit Again(int& count) : plays(count) {}
  void record(const std::function<void()>& what) override {
    work = what;
    work();
  }
  void play() override {
    ++plays;
    const at::AutoGradMode with_gradients(true);  // as at the time of recording
    work();
  }
  std::function<void()> work;
  int& plays;
};

struct AgainRecorder final : Recorder {
  explicit AgainRecorder(int& count) : plays(count) {}
  void warm_up(const std::function<void()>& work) override { work(); }
  std::unique_ptr<Recording> make() override { return std::make_unique<Again>(plays); }
  int& plays;
};

Tensor network(const Tensor& images) {
  const Tensor weights = testing::uniform({7, 3 * 4 * 4}, -1, 1, 3).to(at::kFloat);
  return images.reshape({images.size(0), -1}).mm(weights.t()).tanh().square();
}

Tensor pictures(uint64_t seed) { return testing::uniform({2, 3, 4, 4}, 0, 1, seed).to(at::kFloat); }

Tensor gradient_of(const Tensor& logits, const Tensor& images) {
  const Tensor weight = at::linspace(-1, 1, logits.numel()).view_as(logits);
  return torch::autograd::grad({(logits * weight).sum()}, {images})[0];
}

TEST(RecordedPass, GivesWhatTheNetworkGives) {
  int plays = 0;
  const auto pass =
      std::make_shared<RecordedPass>(std::make_unique<AgainRecorder>(plays), network, pictures(1));
  for (const uint64_t seed : {5, 6}) {
    const Tensor images = pictures(seed).requires_grad_(true);
    const Tensor expected = network(images), actual = played_logits(pass, images);
    EXPECT_TRUE(at::equal(actual, expected));
    EXPECT_TRUE(at::equal(gradient_of(actual, images), gradient_of(expected, images)));
  }
  EXPECT_EQ(plays, 4);  // forward and backward only
}

TEST(RecordedPass, EachBatchHasItsOwnGradientInAnyOrder) {
  int plays = 0;
  const auto pass =
      std::make_shared<RecordedPass>(std::make_unique<AgainRecorder>(plays), network, pictures(1));
  const Tensor a = pictures(5).requires_grad_(true), b = pictures(6).requires_grad_(true);
  const Tensor of_a = played_logits(pass, a), of_b = played_logits(pass, b);
  EXPECT_TRUE(at::equal(of_a, network(a)));  // the run of b did not overwrite it
  EXPECT_TRUE(at::equal(gradient_of(of_a, a), gradient_of(network(a), a)));
  EXPECT_TRUE(at::equal(gradient_of(of_b, b), gradient_of(network(b), b)));
}

TEST(RecordedPass, KeepsTheOrderInMemoryAndTellsWhatFails) {
  int plays = 0;
  const auto layout = [](const Tensor& images) {
    EXPECT_TRUE(images.is_contiguous(at::MemoryFormat::ChannelsLast));
    return images.mean({2, 3});
  };
  const RecordedPass pass(std::make_unique<AgainRecorder>(plays), layout,
                          pictures(1).contiguous(at::MemoryFormat::ChannelsLast));
  EXPECT_EQ(pass.turn(), 0);
  const auto fails = [](const Tensor& images) -> Tensor { return images.mm(images); };
  EXPECT_THROW(RecordedPass(std::make_unique<AgainRecorder>(plays), fails, pictures(1)),
               c10::Error);
}

}  // namespace
}  // namespace tt3d::model
