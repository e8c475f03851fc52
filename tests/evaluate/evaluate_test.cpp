#include "tt3d/evaluate.h"

#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>

#include "support/shapes.h"
#include "support/temporary_folder.h"
#include "tt3d/asset.h"
#include "tt3d/capture.h"
#include "tt3d/field.h"
#include "tt3d/image.h"
#include "tt3d/mesh.h"
#include "tt3d/raster.h"
#include "tt3d/scene.h"
#include "tt3d/surface.h"

namespace tt3d::evaluate {
namespace {

using at::Tensor;

const std::string kToy = std::string(TT3D_SOURCE_DIR) + "/tests/model/fixtures/toy_cnn.pt2";

/// A ball of one colour.
asset::TexturedMesh ball(float red, float green, float blue) {
  const testing::Shape s = testing::sphere(3, 0.8F);
  asset::TexturedMesh mesh;
  mesh.vertices = s.vertices;
  mesh.faces = s.faces;
  mesh.map.uvs = at::tensor({0.25F, 0.25F, 0.75F, 0.25F, 0.5F, 0.75F}).view({3, 2});
  mesh.map.faces =
      at::tensor({0, 1, 2}, at::kInt).view({1, 3}).expand({s.faces.size(0), 3}).contiguous();
  mesh.texture =
      (at::tensor({red, green, blue}) * 255).round().to(at::kByte).expand({8, 8, 3}).contiguous();
  return mesh;
}

TEST(CheckRenderer, TheBuiltInRendererTakesSquareSampleCounts) {
  RendererChoice choice;
  for (const int samples : {0, 1, 4, 9, 64}) {
    choice.samples = samples;
    EXPECT_NO_THROW(check_renderer(choice)) << samples;
  }
  for (const int samples : {2, 8, 81}) {
    choice.samples = samples;
    EXPECT_THROW(check_renderer(choice), InputError) << samples;
  }
  choice.name = RendererName::kMitsuba;
  EXPECT_NO_THROW(check_renderer(choice));
  EXPECT_EQ(samples_of(choice), 81);
  EXPECT_EQ(samples_of({}), 1);
}

TEST(AssetRenderer, ShowsTheTextureAndAntialiasesTheSilhouette) {
  const AssetRenderer renderer(ball(0.2F, 0.6F, 0.8F));
  const auto views =
      scene::sample_views(scene::ViewDistribution::kRing, 1, 0, 2, 48, {{0, 0, 0}, 1, 3.2, 40});
  const Tensor out = renderer.render({views[0].camera, views[1].camera});
  EXPECT_NEAR(out[0][24][24][2].item<double>(), 0.8, 0.01);
  EXPECT_NEAR(out[0][24][24][3].item<double>(), 1, 1e-6);
  EXPECT_EQ(out[0][0][0].abs().sum().item<double>(), 0);
  const Tensor alpha = out.select(3, 3);
  EXPECT_GT(((alpha > 0.05) & (alpha < 0.95)).sum().item<int64_t>(), 20);
}

TEST(RoundTrip, ABakedAndLoadedAssetRendersAsInMemory) {
  // Bakes, writes, loads and renders a smooth colour function, and compares.
  const testing::Shape s = testing::sphere(4, 0.8F);
  const auto colors = [](const raster::SurfacePoints& points) {
    return (0.5 + 0.35 * at::sin(points.positions * 7)).t().contiguous();
  };
  const scene::UvMap atlas = asset::unwrap(s.vertices, s.faces, 1024, 4, 120);
  asset::TexturedMesh mesh = {s.vertices, s.faces, atlas,
                              asset::bake_texture(atlas, 1024, {s.vertices, s.faces}, colors)};
  testing::TemporaryFolder folder;
  asset::write_glb(mesh, folder / "m.glb");
  asset::write_obj(mesh, folder / "m.obj");
  const auto views =
      scene::sample_views(scene::ViewDistribution::kDome, 1, 0, 4, 128, {{0, 0, 0}, 1, 3.2, 40});
  const mesh::RenderMesh prepared(s.faces);
  for (const char* name : {"m.glb", "m.obj"}) {
    const AssetRenderer renderer(asset::load_asset(folder / name));
    for (const scene::SampledView& view : views) {
      const Tensor direct =
          mesh::render_mesh(s.vertices, s.vertices, prepared, {view.camera}, colors)[0];
      const Tensor loaded = renderer.render({view.camera})[0];
      const Tensor white = at::ones({3});
      EXPECT_GT(
          image::psnr(image::over_background(direct, white), image::over_background(loaded, white)),
          35)
          << name;
    }
  }
}

TEST(EvaluateAsset, FiguresEqualACountByHand) {
  testing::TemporaryFolder folder;
  asset::write_glb(ball(0.9F, 0.1F, 0.1F), folder / "adversarial.glb");
  asset::write_glb(ball(0.1F, 0.9F, 0.1F), folder / "clean.glb");
  EvaluateOptions o;
  o.asset = folder / "adversarial.glb";
  o.clean = folder / "clean.glb";
  o.victims = {kToy};
  o.views = 23;
  o.size = 32;
  Progress quiet;
  asset::AssetFiles assets;
  // Choose the class that the toy model returns most often, so that both outcomes occur.
  o.target = "3";
  record::EvaluationRecord r = evaluate_asset(o, assets, quiet);
  std::map<int64_t, int64_t> votes;
  for (const record::ViewAnswer& a : r.victims[0].answers) ++votes[a.top1];
  o.target = std::to_string(r.victims[0].answers[0].top1);
  o.true_class = std::to_string(r.victims[0].answers[0].clean_top1.value());
  r = evaluate_asset(o, assets, quiet);
  const record::VictimRecord& v = r.victims[0];
  ASSERT_EQ(v.answers.size(), 23U);

  // Count by hand: render, resize and crop as in the model card, and run the model.
  const auto model = model::Classifier::load(kToy);
  const AssetRenderer adversarial(asset::load_asset(o.asset)), clean(asset::load_asset(o.clean));
  const auto views = evaluation_views(scene::ViewDistribution::kDome, 0, 23, 32,
                                      asset::view_frame(asset::load_asset(o.asset), o.asset));
  int64_t hits = 0, correct = 0, both = 0;
  double psnr_sum = 0;
  for (const scene::SampledView& view : views) {
    const auto picture = [&](const AssetRenderer& renderer) {
      return (image::over_background(renderer.render({view.camera})[0], at::ones({3})).clamp(0, 1) *
              255)
                 .round() /
             255;
    };
    const auto top1 = [&](const Tensor& x) {
      at::NoGradGuard guard;
      return model
          ->logits(model::preprocess(x.permute({2, 0, 1}).unsqueeze(0).contiguous(), model->card()))
          .argmax(1)
          .item<int64_t>();
    };
    const bool hit = top1(picture(adversarial)) == r.target.index;
    const bool right = top1(picture(clean)) == r.true_class->index;
    hits += hit;
    correct += right;
    both += hit && right;
    psnr_sum += image::psnr(picture(adversarial), picture(clean));
  }
  EXPECT_NEAR(v.asr, double(hits) / 23, 1e-12);
  EXPECT_NEAR(*v.clean_accuracy, double(correct) / 23, 1e-12);
  EXPECT_EQ(v.asr_on_correct_n, correct);
  if (correct > 0) {
    EXPECT_NEAR(*v.asr_on_correct, double(both) / double(correct), 1e-12);
  }
  EXPECT_NEAR(*r.naturalness.psnr, psnr_sum / 23, 1e-6);
  EXPECT_LE(v.asr_ci95.low, v.asr);
  EXPECT_GE(v.asr_ci95.high, v.asr);
}

TEST(EvaluateAsset, TheRecordHasAllDocumentedKeys) {
  testing::TemporaryFolder folder;
  asset::write_glb(ball(0.9F, 0.1F, 0.1F), folder / "a.glb");
  EvaluateOptions o;
  o.asset = folder / "a.glb";
  o.victims = {kToy};
  o.target = "teapot";
  o.views = 3;
  o.size = 24;
  Progress quiet;
  asset::AssetFiles assets;
  record::save(evaluate_asset(o, assets, quiet), folder / "out" / "e.json");
  const auto j = nlohmann::json::parse(read_file(folder / "out/e.json"));
  for (const char* key : {"asset", "asset_sha256", "target", "true_class", "renderer", "background",
                          "views", "victims", "naturalness", "tt3d_version", "wall_seconds"}) {
    EXPECT_TRUE(j.contains(key)) << key;
  }
  for (const char* key : {"name", "sha256", "clean_accuracy", "clean_n", "asr", "asr_ci95",
                          "asr_on_correct", "asr_on_correct_n", "mean_target_probability"}) {
    EXPECT_TRUE(j["victims"][0].contains(key)) << key;
  }
  EXPECT_EQ(j["target"]["index"], 3);
  EXPECT_TRUE(j["victims"][0]["clean_accuracy"].is_null());
  std::istringstream csv(read_file(folder / "out/e.csv"));
  std::string header;
  std::getline(csv, header);
  EXPECT_EQ(header,
            "victim,view,azimuth_deg,elevation_deg,distance,roll_deg,top1_index,top1_name,p_top1,"
            "p_target,p_true,clean_top1_index");
  int rows = 0;
  for (std::string line; std::getline(csv, line);) ++rows;
  EXPECT_EQ(rows, 3);
}

TEST(EvaluateAsset, WrongOptionsAreInputErrors) {
  testing::TemporaryFolder folder;
  asset::write_glb(ball(0.9F, 0.1F, 0.1F), folder / "a.glb");
  EvaluateOptions good;
  good.asset = folder / "a.glb";
  good.victims = {kToy};
  good.target = "teapot";
  good.views = 1;
  good.size = 24;
  Progress quiet;
  asset::AssetFiles assets;
  const auto refuses = [&](const std::function<void(EvaluateOptions&)>& change) {
    EvaluateOptions o = good;
    change(o);
    EXPECT_THROW((void)evaluate_asset(o, assets, quiet), InputError);
  };
  refuses([](EvaluateOptions& o) { o.target = "no such class"; });
  refuses([](EvaluateOptions& o) { o.target = "crane"; });  // ambiguous
  refuses([](EvaluateOptions& o) { o.victims = {"no-such-model"}; });
  refuses([](EvaluateOptions& o) { o.victims = {}; });
  refuses([](EvaluateOptions& o) { o.asset = "/nonexistent.glb"; });
}

TEST(ViewFrameFile, SurvivesARoundTripAndRejectsMalformedFiles) {
  testing::TemporaryFolder folder;
  const asset::TexturedMesh mesh = ball(1, 0, 0);
  asset::write_view_frame({{1, 2, 3}, 4, 5, 60}, folder.path());
  const scene::ViewFrame frame = asset::view_frame(mesh, folder / "a.glb");
  EXPECT_EQ(frame.centre[2], 3);
  EXPECT_EQ(frame.fov_y_deg, 60);
  for (const char* bad : {"", "{}", R"({"centre":[1,2],"radius":1,"distance":1,"fov_y_deg":1})",
                          R"({"centre":[1,2,3],"radius":-1,"distance":1,"fov_y_deg":1})"}) {
    write_file_atomic(folder / "views.json", bad);
    EXPECT_THROW((void)asset::view_frame(mesh, folder / "a.glb"), InputError) << bad;
  }
}

TEST(RenderToFolder, LoadsAsACaptureWithTheSameViews) {
  testing::TemporaryFolder folder;
  asset::write_glb(ball(0.2F, 0.6F, 0.8F), folder / "a.glb");
  Progress quiet;
  EvaluateOptions shown;
  shown.asset = folder / "a.glb";
  shown.views = 6;
  shown.size = 48;
  shown.seed = 3;
  render_to_folder(shown, folder / "views", quiet);
  capture::CaptureOptions o;
  o.path = folder / "views";
  o.format = capture::CaptureFormat::kNerfSynthetic;
  const capture::Capture capture = capture::load_capture(o, quiet);
  EXPECT_EQ(capture.train.size(), 5U);
  EXPECT_EQ(capture.test.size(), 1U);
  EXPECT_TRUE(capture.has_masks);
  const Tensor middle = capture.train[0].rgba[24][24];
  EXPECT_NEAR(middle[2].item<double>(), 204, 2);
}

}  // namespace
}  // namespace tt3d::evaluate
