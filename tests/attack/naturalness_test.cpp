#include "attack/naturalness.h"

#include <gtest/gtest.h>

#include <cmath>

#include "attack/toy_attack.h"
#include "support/gradient_check.h"
#include "support/temporary_folder.h"

namespace tt3d {
namespace {

using at::Tensor;

double value(const Tensor& x) { return x.item<double>(); }

TEST(TotalVariation, ByHand) {
  // One pixel of 3 next to (down 4, right 0): lengths 5, then 4, 3 and 0 over a 3 x 3 picture.
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
  // Also where nothing was changed.
  EXPECT_LT(testing::gradient_error(variation, {at::zeros({1, 1, 3, 3})}), 1e-6);
}

TEST(NonPrintability, ByHand) {
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

TEST(Displacement, LongOffsetsAreShortenedAndOthersKept) {
  const Tensor offsets = at::tensor({3.F, 4.F, 0.F, 0.F, 0.1F, 0.F, 0.F, 0.F, 0.F}).view({3, 3});
  limit_offsets(offsets, 1);
  EXPECT_TRUE(at::allclose(
      offsets, at::tensor({0.6F, 0.8F, 0.F, 0.F, 0.1F, 0.F, 0.F, 0.F, 0.F}).view({3, 3})));
}

TEST(Displacement, BoundHoldsAfterAnAttack) {
  Progress quiet;
  testing::TemporaryFolder folder;
  const AttackInput input = testing::ball_input(0);
  AttackOptions o = testing::toy_options();
  o.vertex_rate = 1e-2;
  o.steps = 10;
  const auto farthest = [&](const char* checkpoint) {
    const AttackResult r = run_attack(input, o, 1, folder / checkpoint, quiet);
    return value((r.mesh.vertices - input.mesh.vertices).norm(2, {1}).max());
  };
  EXPECT_GT(farthest("free"), 0.02);
  o.max_displacement = 0.01;
  EXPECT_LE(farthest("bound"), 0.01 + 1e-6);
}

/// What is shown of a ball: pictures 0.1 off the clean ones, colours 0.5.
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
  none.rgb_weight = none.chamfer_weight = none.laplacian_weight = none.edge_weight = 0;
  none.printer_colors = folder / "p.txt";
  const Tensor& rest = input.mesh.vertices;
  const auto total = [&](const AttackOptions& o, const Tensor& vertices) {
    return value(Naturalness(input, o).terms(shown_ball(), vertices).total);
  };
  AttackOptions o = none;
  EXPECT_EQ(total(o, rest), 0);
  o.rgb_weight = 2;
  EXPECT_NEAR(total(o, rest), 0.02, 1e-7);
  o.psnr_floor = 20;  // stands for 0.01
  EXPECT_NEAR(total(o, rest), 0, 1e-7);
  o = none;
  o.printability_weight = 3;
  EXPECT_NEAR(total(o, rest), 3 * 0.4, 1e-5);
  o = none;
  o.variation_weight = 5;
  EXPECT_NEAR(total(o, rest), 0, 1e-6);
  o = none;
  o.displacement_weight = 7;
  // A shift is no displacement of neighbours against each other; a swelling is.
  EXPECT_NEAR(total(o, rest + 0.1), 0, 1e-9);
  const double edge = value(MeshRegularizer(input.mesh).edge_length(rest));
  EXPECT_NEAR(total(o, rest * 1.1), 7 * 0.01 * edge, 1e-7);
  o.optimize = {"grid"};
  EXPECT_EQ(total(o, rest * 1.1), 0);
}

TEST(Naturalness, WithoutAListPrintabilityTakesMixesOfInks) {
  const Tensor mixes = process_ink_mixes();
  EXPECT_EQ(mixes.size(0), 27);
  const auto color = [](float r, float g, float b) { return at::tensor({r, g, b}); };
  EXPECT_TRUE(at::allclose(mixes[0], color(1, 1, 1)));             // paper
  EXPECT_TRUE(at::allclose(mixes[2], color(0, 0.68F, 0.94F)));     // full cyan
  EXPECT_TRUE(at::allclose(mixes[1], color(0.5F, 0.84F, 0.97F)));  // half of it
  EXPECT_TRUE(at::allclose(mixes[6 + 18], color(0.93F, 0, 0)));    // magenta and yellow: red
  EXPECT_TRUE(at::allclose(mixes[26], color(0, 0, 0)));
}

TEST(Naturalness, UnknownWeightsAreInputErrors) {
  AttackOptions o;
  o.laplacian = "cotan";
  EXPECT_THROW(Naturalness(testing::ball_input(0), o), InputError);
}

TEST(Naturalness, PrintableColoursAreApproached) {
  Progress quiet;
  testing::TemporaryFolder folder;
  write_file_atomic(folder / "p.txt", "0 0 0\n1 1 1\n");
  const Tensor printable = load_printer_colors(folder / "p.txt");
  const AttackInput input = testing::ball_input(0);
  AttackOptions o = testing::toy_options(attack_preset("mesh"));
  o.beta = 1000;
  o.printability_weight = 1;
  o.printer_colors = folder / "p.txt";
  const AttackResult r = run_attack(input, o, 1, folder / "c", quiet);
  const auto clean = VertexColorAppearance::sample(*input.appearance, input.mesh);
  const auto score = [&](const Appearance& look) {
    return value(non_printability(look.parameters()[0].t(), printable));
  };
  EXPECT_LT(score(*r.appearance), 0.7 * score(*clean));
}

}  // namespace
}  // namespace tt3d
