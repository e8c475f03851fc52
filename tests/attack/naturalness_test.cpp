#include "attack/naturalness.h"

#include <gtest/gtest.h>

#include <cmath>

#include "attack/toy_attack.h"
#include "support/gradient_check.h"
#include "support/temporary_folder.h"
#include "tt3d/appearance.h"
#include "tt3d/attack.h"
#include "tt3d/mesh.h"

namespace tt3d::attack {
namespace {

using at::Tensor;
using testing::value;

TEST(TotalVariation, EqualsAComputationByHand) {
  Tensor x = at::zeros({1, 1, 3, 3}, at::kDouble);
  x[0][0][0][1] = 4;
  x[0][0][1][0] = 3;
  // At (0,0) differences 3 and 4, at (0,1) 4 and 4, at (1,0) 3 and 3, at (1,1) none.
  EXPECT_NEAR(value(total_variation(x)), (5 + 4 * std::sqrt(2) + 3 * std::sqrt(2)) / 4, 1e-3);
  EXPECT_NEAR(value(total_variation(at::full({2, 3, 4, 4}, 0.7))), 0, 1e-9);
}

TEST(TotalVariation, GradientAgainstCentralDifferences) {
  const auto variation = [](const std::vector<Tensor>& in) { return total_variation(in[0]); };
  EXPECT_LT(testing::gradient_error(variation, {testing::uniform({1, 2, 4, 5}, 0, 1, 3)}), 1e-6);
  // Also without a change.
  EXPECT_LT(testing::gradient_error(variation, {at::zeros({1, 1, 3, 3})}), 1e-6);
}

TEST(NonPrintability, EqualsAComputationByHand) {
  const Tensor printable = at::tensor({0.0, 0.0, 0.0, 1.0, 1.0, 1.0}).view({2, 3});
  const Tensor colors = at::tensor({0.3, 0.4, 0.0, 1.0, 1.0, 0.9}).view({2, 3}).t();
  EXPECT_NEAR(value(non_printability(colors, printable)), (0.5 + 0.1) / 2, 1e-6);
}

TEST(NonPrintability, GradientAgainstCentralDifferences) {
  const Tensor printable = testing::uniform({6, 3}, 0, 1, 8);
  EXPECT_LT(testing::gradient_error(
                [&](const std::vector<Tensor>& in) { return non_printability(in[0], printable); },
                {testing::uniform({3, 7}, 0, 1, 9)}),
            1e-6);
}

TEST(PrinterColors, AreReadWithCommasSpacesAndComments) {
  testing::TemporaryFolder folder;
  write_file_atomic(folder / "p.txt", "# ink\n0.1,0.2,0.3\n\n1 0 0.5  # red\n");
  const Tensor colors = load_printer_colors(folder / "p.txt");
  EXPECT_TRUE(at::allclose(colors, at::tensor({0.1F, 0.2F, 0.3F, 1.F, 0.F, 0.5F}).view({2, 3})));
}

TEST(PrinterColors, ErrorsNameFileAndLine) {
  testing::TemporaryFolder folder;
  for (const char* bad : {"0 0 0\n0.1 0.2\n", "0 0 0\n0.1 0.2 0.3 0.4\n", "0 0 0\n0 0 2\n",
                          "0 0 0\nred green blue\n"}) {
    write_file_atomic(folder / "p.txt", bad);
    try {
      (void)load_printer_colors(folder / "p.txt");
      FAIL() << bad;
    } catch (const InputError& error) {
      EXPECT_NE(std::string(error.what()).find("p.txt:2:"), std::string::npos) << error.what();
    }
  }
  write_file_atomic(folder / "p.txt", "# nothing\n");
  EXPECT_THROW((void)load_printer_colors(folder / "p.txt"), InputError);
  EXPECT_THROW((void)load_printer_colors(folder / "none.txt"), InputError);
}

TEST(Displacement, OnlyLongOffsetsAreShortened) {
  const Tensor offsets = at::tensor({3.F, 4.F, 0.F, 0.F, 0.1F, 0.F, 0.F, 0.F, 0.F}).view({3, 3});
  limit_offsets(offsets, 1);
  EXPECT_TRUE(at::allclose(
      offsets, at::tensor({0.6F, 0.8F, 0.F, 0.F, 0.1F, 0.F, 0.F, 0.F, 0.F}).view({3, 3})));
}

TEST(Displacement, TheBoundHoldsAfterAnAttack) {
  Progress quiet;
  testing::TemporaryFolder folder;
  const AttackInput input = testing::ball_input(0);
  AttackOptions o = testing::toy_options();
  o.schedule.vertex_rate = 1e-2;
  o.schedule.steps = 10;
  const auto farthest = [&](const char* checkpoint) {
    const AttackResult r = run_attack(input, o, 1, folder / checkpoint, quiet);
    return value((r.object.mesh.vertices - input.object.mesh.vertices).norm(2, {1}).max());
  };
  EXPECT_GT(farthest("free"), 0.02);
  o.naturalness.max_displacement = 0.01;
  EXPECT_LE(farthest("bound"), 0.01 + 1e-6);
}

/// The rendering of a ball: pictures differ from the clean ones by 0.1, colours by 0.5.
Rendering shown_ball() {
  Rendering r;
  r.pictures = at::full({1, 4, 16, 16}, 0.6);
  r.pictures.select(1, 3).fill_(1);
  r.clean = at::full({1, 3, 16, 16}, 0.5);
  r.colors = at::full({3, 9}, 0.5);
  r.rgb = at::full({}, 0.01);
  return r;
}

TEST(Naturalness, WeighsItsTerms) {
  const AttackInput input = testing::ball_input(0);
  testing::TemporaryFolder folder;
  write_file_atomic(folder / "p.txt", "0.5 0.5 0.1\n");
  AttackOptions none;
  NaturalnessOptions& weights = none.naturalness;
  weights.rgb_weight = weights.chamfer_weight = weights.laplacian_weight = weights.edge_weight = 0;
  weights.psnr_floor = weights.ssim_floor = 0;
  weights.printer_colors = folder / "p.txt";
  const Tensor& rest = input.object.mesh.vertices;
  const auto total = [&](const AttackOptions& o, const Tensor& vertices) {
    return value(Naturalness(input, o).terms(shown_ball(), vertices).total);
  };
  AttackOptions o = none;
  EXPECT_EQ(total(o, rest), 0);
  o.naturalness.rgb_weight = 2;
  EXPECT_NEAR(total(o, rest), 0.02, 1e-7);
  o.naturalness.psnr_floor = 20;  // a mean squared error of 0.01
  EXPECT_NEAR(total(o, rest), 0, 1e-7);
  o = none;
  o.naturalness.printability_weight = 3;
  EXPECT_NEAR(total(o, rest), 3 * 0.4, 1e-5);
  o = none;
  o.naturalness.variation_weight = 5;
  EXPECT_NEAR(total(o, rest), 0, 1e-6);
  o = none;
  o.naturalness.displacement_weight = 7;
  // A shift does not displace neighbours relative to each other; scaling does.
  EXPECT_NEAR(total(o, rest + 0.1), 0, 1e-9);
  const double edge = value(mesh::MeshRegularizer(input.object.mesh).edge_length(rest));
  EXPECT_NEAR(total(o, rest * 1.1), 7 * 0.01 * edge, 1e-7);
  o.optimize = {object::Part::kGrid};
  EXPECT_EQ(total(o, rest * 1.1), 0);
}

TEST(Naturalness, WithoutAListPrintabilityUsesMixesOfInks) {
  const Tensor mixes = process_ink_mixes();
  EXPECT_EQ(mixes.size(0), 27);
  const auto color = [](float r, float g, float b) { return at::tensor({r, g, b}); };
  EXPECT_TRUE(at::allclose(mixes[0], color(1, 1, 1)));             // paper
  EXPECT_TRUE(at::allclose(mixes[2], color(0, 0.68F, 0.94F)));     // full cyan
  EXPECT_TRUE(at::allclose(mixes[1], color(0.5F, 0.84F, 0.97F)));  // half of it
  EXPECT_TRUE(at::allclose(mixes[6 + 18], color(0.93F, 0, 0)));    // magenta and yellow: red
  EXPECT_TRUE(at::allclose(mixes[26], color(0, 0, 0)));
}

TEST(Naturalness, AnAttackMovesColoursTowardsPrintableOnes) {
  Progress quiet;
  testing::TemporaryFolder folder;
  write_file_atomic(folder / "p.txt", "0 0 0\n1 1 1\n");
  const Tensor printable = load_printer_colors(folder / "p.txt");
  const AttackInput input = testing::ball_input(0);
  AttackOptions o = testing::toy_options(attack_preset("mesh"));
  o.naturalness.beta = 1000;
  o.naturalness.printability_weight = 1;
  o.naturalness.printer_colors = folder / "p.txt";
  const AttackResult r = run_attack(input, o, 1, folder / "c", quiet);
  const auto clean =
      object::VertexColorAppearance::sample(*input.object.appearance, input.object.mesh);
  const auto score = [&](const object::Appearance& look) {
    return value(non_printability(look.parameters()[0].t(), printable));
  };
  EXPECT_LT(score(*r.object.appearance), 0.7 * score(*clean));
}

}  // namespace
}  // namespace tt3d::attack
