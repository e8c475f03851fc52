#include <gtest/gtest.h>

#include "attack/toy_attack.h"
#include "gpu/both_devices.h"
#include "support/stop_after.h"
#include "support/temporary_folder.h"
#include "tt3d/attack.h"

namespace tt3d {
namespace {

using at::Tensor;

struct AttackOnGpu : testing::OnGpu {};

TEST_F(AttackOnGpu, TransformsAndTheirGradients) {
  for (const int64_t step : {0, 1, 2}) {
    testing::expect_same(
        "transform_images", gpu,
        [&](const std::vector<Tensor>& in) {
          return transform_images(in[0], 32, EotOptions{}, 1, step);
        },
        {testing::uniform({3, 4, 48, 48}, 0, 1, 5).to(at::kFloat)}, 1e-3);
  }
}

TEST_F(AttackOnGpu, ReachesTheTargetAndGoesOnAfterAStop) {
  for (const AttackPreset& preset : attack_presets()) {
    testing::TemporaryFolder folder;
    const AttackOptions o = testing::toy_options(preset);
    if (!testing::frees_colors(o)) continue;  // shape or a patch is not enough
    testing::StopAfter stop(15);
    EXPECT_THROW((void)run_attack(testing::ball_input(2, gpu), o, 1, folder / "c", stop),
                 Interrupted);
    Progress quiet;
    const AttackResult r = run_attack(testing::ball_input(2, gpu), o, 1, folder / "c", quiet);
    EXPECT_EQ(r.mesh.vertices.device(), gpu);
    double success = 0;
    for (size_t i = r.curves.size() - 10; i < r.curves.size(); ++i) success += r.curves[i].success;
    EXPECT_GE(success, 9.0) << preset.name;
    save_attack(r, folder / "r.safetensors");
    EXPECT_TRUE(
        at::equal(load_attack(folder / "r.safetensors").mesh.vertices, r.mesh.vertices.cpu()));
  }
}

}  // namespace
}  // namespace tt3d
