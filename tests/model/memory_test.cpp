#include <ATen/ATen.h>
#include <gtest/gtest.h>
#include <torch/csrc/autograd/autograd.h>

#include "model/package_tools.h"
#include "model/tensor_memory.h"
#include "support/error_of.h"
#include "support/temporary_folder.h"
#include "tt3d/model.h"

namespace tt3d::model {
namespace {

namespace fs = std::filesystem;
using testing::toy;

std::shared_ptr<Classifier> with_limit(const std::string& name, int64_t bytes) {
  ModelLimits limits;
  limits.intermediate_bytes = bytes;
  ModelOptions options;
  options.check_probe = false;
  return Classifier::load(toy(name), limits, nullptr, options);
}

/// The gradient of a weighted sum of the logits with respect to the images.
at::Tensor gradient(const Classifier& model, const at::Tensor& images) {
  const at::Tensor leaf = images.detach().clone().requires_grad_(true);
  const at::Tensor logits = model.logits(leaf);
  const at::Tensor weight = at::linspace(-1, 1, logits.numel()).view_as(logits);
  return torch::autograd::grad({(logits * weight).sum()}, {leaf})[0];
}

TEST(Memory, BatchSplitsWhenItRunsShort) {
  for (const std::string name : {"toy_cnn", "toy_vit"}) {
    const at::Tensor images = at::rand({16, 3, 16, 16});
    const at::Tensor expected = Classifier::load(toy(name))->logits(images);
    const at::Tensor actual = with_limit(name, 150000)->logits(images);
    EXPECT_TRUE(at::allclose(expected, actual, 1e-4, 1e-5)) << name;
  }
}

TEST(Memory, GradientsOfASplitBatchAreThoseOfTheWhole) {
  for (const std::string name : {"toy_cnn", "toy_vit", "toy_norm"}) {
    const at::Tensor images = at::rand({13, 3, 16, 16});
    const at::Tensor expected = gradient(*Classifier::load(toy(name)), images);
    const auto model = with_limit(name, 150000);
    for (int repeat = 0; repeat < 2; ++repeat) {
      const at::Tensor actual = gradient(*model, images);
      EXPECT_TRUE(at::allclose(expected, actual, 1e-3, 1e-6)) << name;
    }
  }
}

/// A graph before the model gets the same gradient from a split batch as from a whole one.
TEST(Memory, SplitBatchIsPartOfALongerGraph) {
  const at::Tensor images = at::rand({9, 3, 16, 16});
  std::vector<at::Tensor> gradients;
  for (const int64_t limit : {int64_t{1} << 30, int64_t{150000}}) {
    const auto model = with_limit("toy_cnn", limit);
    const at::Tensor scale = at::ones({1}).requires_grad_(true);
    (model->logits((images * scale).clamp(0, 1)) * at::arange(7)).sum().backward();
    gradients.push_back(scale.grad());
  }
  EXPECT_TRUE(at::allclose(gradients[0], gradients[1], 1e-3, 1e-5));
}

TEST(Memory, SplittingBoundsWhatGradientsHold) {
  testing::TensorMemory& memory = testing::TensorMemory::instance();
  const at::Tensor images = at::rand({4096, 3, 16, 16});
  const int64_t limit = int64_t{8} << 20;
  const auto whole = with_limit("toy_cnn", int64_t{1} << 34);
  const auto parts = with_limit("toy_cnn", limit);
  const int64_t held_parts = memory.peak_growth([&] { (void)gradient(*parts, images); });
  const int64_t held_whole = memory.peak_growth([&] { (void)gradient(*whole, images); });
  // The caller's part: images, their normalised copies and their gradient.
  const auto images_bytes = static_cast<int64_t>(images.nbytes());
  EXPECT_LT(held_parts, 4 * images_bytes + 2 * limit);
  EXPECT_LT(held_parts + 2 * images_bytes, held_whole);  // that holds all images' activations
}

TEST(Memory, OneImageThatDoesNotFitIsAResourceError) {
  const auto model = with_limit("toy_cnn", 1000);
  EXPECT_THROW((void)model->logits(at::rand({1, 3, 16, 16})), ResourceError);
  EXPECT_THROW((void)gradient(*model, at::rand({2, 3, 16, 16})), ResourceError);
  const std::string error = testing::error_of<ResourceError>([] {
    (void)with_limit("toy_cnn", 1000)->logits(at::rand({1, 3, 16, 16}));
  });
  for (const char* part : {"with a single image: ", "GiB of memory are free", "this process holds",
                           "use fewer or smaller models"}) {
    EXPECT_NE(error.find(part), std::string::npos) << error;
  }
}

TEST(Memory, GradientsOutliveTheClassifier) {
  const at::Tensor images = at::rand({9, 3, 16, 16}).requires_grad_(true);
  at::Tensor logits, expected;
  {
    const auto model = with_limit("toy_cnn", 150000);
    expected = gradient(*model, images.detach());
    logits = model->logits(images);
  }
  (logits * at::linspace(-1, 1, logits.numel()).view_as(logits)).sum().backward();
  EXPECT_TRUE(at::allclose(images.grad(), expected, 1e-5, 1e-7));
  EXPECT_GT(expected.abs().max().item<float>(), 1e-4);
}

/// Weights that are aligned in the archive are used from there; compressed or unaligned ones are
/// copied. The results are equal.
TEST(Memory, MappedAndCopiedWeightsAreTheSame) {
  const testing::TemporaryFolder folder;
  const at::Tensor images = at::rand({2, 3, 16, 16});
  const at::Tensor expected = Classifier::load(toy("toy_cnn"))->logits(images);
  for (const bool deflate : {false, true}) {
    const fs::path path = folder / (deflate ? "deflated.pt2" : "unaligned.pt2");
    testing::pack(path, testing::unpack(testing::fixture("toy_cnn.pt2")), deflate);
    testing::write_card(path, "toy_cnn");
    EXPECT_TRUE(Classifier::load(path.string())->logits(images).equal(expected));
  }
}

TEST(Memory, ReplacedArchiveDoesNotChangeALoadedModel) {
  const testing::TemporaryFolder folder;
  const fs::path path = folder / "toy.pt2";
  fs::copy_file(toy("toy_vit"), path);
  testing::write_card(path, "toy_vit");
  const auto model = Classifier::load(path.string());
  const at::Tensor images = at::rand({2, 3, 16, 16});
  const at::Tensor before = model->logits(images);
  const std::string hash = model->weights_hash();
  write_file_atomic(path, "another file");
  EXPECT_TRUE(model->logits(images).equal(before));
  EXPECT_EQ(model->weights_hash(), hash);
}

}  // namespace
}  // namespace tt3d::model
