#include <c10/cuda/CUDACachingAllocator.h>
#include <cuda_runtime.h>
#include <gtest/gtest.h>
#include <torch/csrc/autograd/autograd.h>

#include "attack/picture_ops.h"
#include "attack/toy_attack.h"
#include "gpu/both_devices.h"
#include "support/count_notes.h"
#include "support/stop_after.h"
#include "support/temporary_folder.h"
#include "tt3d/attack.h"
#include "tt3d/gpu_options.h"
#include "tt3d/model.h"

namespace tt3d {
namespace {

using at::Tensor;

struct AttackOnGpu : testing::OnGpu {};

TEST_F(AttackOnGpu, TransformsAndTheirGradients) {
  for (const int64_t step : {0, 1, 2}) {
    testing::expect_same(
        "transform_images", gpu,
        [&](const std::vector<Tensor>& in) {
          return attack::transform_images(in[0], 32, attack::EotOptions{}, 1, step);
        },
        {testing::uniform({3, 4, 48, 48}, 0, 1, 5).to(at::kFloat)}, 1e-3);
  }
}

TEST_F(AttackOnGpu, RenderingsOverWhiteAndOverBackgroundsAndTheirGradients) {
  const Tensor maps = testing::uniform({2, 2, 3}, -1.2, 1.2, 1);
  const Tensor background = testing::uniform({2, 3, 1, 1}, 0, 1, 2);
  const auto part = [](const Tensor& wide) { return wide.narrow(3, 4, 4).permute({0, 3, 1, 2}); };
  const Tensor wide = testing::uniform({2, 9, 70, 8}, 0, 1, 3).to(at::kFloat);
  testing::expect_same(
      "over_white", gpu, [&](const auto& in) { return attack::over_white(part(in[0])); }, {wide},
      1e-6);
  testing::expect_same(
      "place_over", gpu,
      [&](const auto& in) {
        const at::Device device = in[0].device();
        return attack::place_over(part(in[0]), maps.to(device), background.to(device), 75);
      },
      {wide}, 1e-4);
}

/// The gradient of a weighted sum of the logits.
Tensor picture_gradient(const Tensor& logits, const Tensor& pictures) {
  const Tensor weight = at::linspace(-1, 1, logits.numel(), logits.options()).view_as(logits);
  return torch::autograd::grad({(logits * weight).sum()}, {pictures})[0];
}

TEST_F(AttackOnGpu, ClassifiersPlayedAsCudaGraphsGiveTheSame) {
  for (const char* name : {"toy_cnn", "toy_vit", "toy_norm"}) {
    const auto model = model::Classifier::load(
        std::string(TT3D_SOURCE_DIR "/tests/model/fixtures/") + name + ".pt2");
    // Two batch sizes, each twice: first recorded, then replayed.
    for (int round = 0; round < 2; ++round) {
      for (const int64_t count : {4, 6}) {
        std::vector<Tensor> batches, expected;
        for (uint64_t k = 0; k < 2; ++k) {
          batches.push_back(testing::uniform({count, 3, 16, 16}, 0, 1, 7 + k)
                                .to(gpu, at::kFloat)
                                .requires_grad_(true));
          const Tensor logits = model->logits(batches.back());
          expected.push_back(logits.detach());
          expected.push_back(picture_gradient(logits, batches.back()));
        }
        use_gpu_options({.graphs = true});
        const Tensor a = model->logits(batches[0]), b = model->logits(batches[1]);
        const std::vector<Tensor> actual = {a.detach(), picture_gradient(a, batches[0]), b.detach(),
                                            picture_gradient(b, batches[1])};
        use_gpu_options({});
        for (size_t i = 0; i < actual.size(); ++i) {
          EXPECT_LE(testing::relative_difference(expected[i], actual[i]), 1e-5) << name << " " << i;
        }
      }
    }
  }
}

TEST_F(AttackOnGpu, OutOfMemoryHalvesTheViewsAndTheWorkGoesOn) {
  using c10::cuda::CUDACachingAllocator::emptyCache;
  using c10::cuda::CUDACachingAllocator::setMemoryFraction;
  attack::AttackOptions o = testing::toy_options();
  o.schedule.steps = 4;
  o.schedule.views_per_step = 256;
  o.schedule.image_size = 512;
  const attack::AttackInput input = testing::ball_input(2, gpu);
  emptyCache();
  size_t free = 0, total = 0;
  ASSERT_EQ(cudaMemGetInfo(&free, &total), cudaSuccess);
  constexpr double kAllowed = 3e9;  // 256 views need several times as much
  setMemoryFraction(kAllowed / static_cast<double>(total), gpu.index());
  testing::CountNotes notes;
  testing::TemporaryFolder folder;
  const attack::AttackResult r = attack::run_attack(input, o, 1, folder / "c", notes);
  setMemoryFraction(1.0, gpu.index());
  EXPECT_GE(notes.count, 1);
  EXPECT_EQ(r.curves.size(), 4U);
}

TEST_F(AttackOnGpu, ReachesTheTargetAndGoesOnAfterAStop) {
  for (const attack::AttackPreset& preset : attack::attack_presets()) {
    testing::TemporaryFolder folder;
    const attack::AttackOptions o = testing::toy_options(preset);
    if (!testing::frees_colors(o)) continue;  // shape or a patch alone does not suffice
    testing::StopAfter stop(15);
    EXPECT_THROW((void)attack::run_attack(testing::ball_input(2, gpu), o, 1, folder / "c", stop),
                 Interrupted);
    Progress quiet;
    const attack::AttackResult r =
        attack::run_attack(testing::ball_input(2, gpu), o, 1, folder / "c", quiet);
    EXPECT_EQ(r.object.mesh.vertices.device(), gpu);
    double success = 0;
    for (size_t i = r.curves.size() - 10; i < r.curves.size(); ++i) success += r.curves[i].success;
    EXPECT_GE(success, 9.0) << preset.name;
    attack::save_attack(r, folder / "r.safetensors");
    EXPECT_TRUE(at::equal(object::load_object(folder / "r.safetensors").mesh.vertices,
                          r.object.mesh.vertices.cpu()));
  }
}

}  // namespace
}  // namespace tt3d
