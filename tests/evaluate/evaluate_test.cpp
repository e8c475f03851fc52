#include "tt3d/evaluate.h"

#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>

#include "support/shapes.h"
#include "support/temporary_folder.h"
#include "tt3d/field.h"
#include "tt3d/mesh.h"

namespace tt3d {
namespace {

using at::Tensor;

const std::string kToy = std::string(TT3D_SOURCE_DIR) + "/tests/model/fixtures/toy_cnn.pt2";

/// A ball of one colour.
TexturedMesh ball(float red, float green, float blue) {
  const testing::Shape s = testing::sphere(3, 0.8F);
  TexturedMesh mesh;
  mesh.vertices = s.vertices;
  mesh.faces = s.faces;
  mesh.uvs = at::tensor({0.25F, 0.25F, 0.75F, 0.25F, 0.5F, 0.75F}).view({3, 2});
  mesh.uv_faces =
      at::tensor({0, 1, 2}, at::kInt).view({1, 3}).expand({s.faces.size(0), 3}).contiguous();
  mesh.texture =
      (at::tensor({red, green, blue}) * 255).round().to(at::kByte).expand({8, 8, 3}).contiguous();
  return mesh;
}

TEST(Measures, PsnrOfAKnownError) {
  const Tensor a = at::zeros({8, 8, 3}), b = at::full({8, 8, 3}, 0.1F);
  EXPECT_NEAR(psnr(a, b), 20, 1e-5);
  EXPECT_EQ(psnr(a, a), 100);
}

TEST(Measures, SsimOfEqualConstantAndInvertedPictures) {
  const Tensor a = testing::uniform({24, 24, 3}, 0, 1, 1).to(at::kFloat);
  EXPECT_NEAR(ssim(a, a), 1, 1e-9);
  EXPECT_LT(ssim(a, 1 - a), 0);
  // Constant pictures: only the luminance term is left, (2ab + c1) / (a^2 + b^2 + c1).
  const Tensor x = at::full({16, 16, 1}, 0.4F), y = at::full({16, 16, 1}, 0.6F);
  EXPECT_NEAR(ssim(x, y), (2 * 0.24 + 1e-4) / (0.16 + 0.36 + 1e-4), 1e-6);
}

TEST(Measures, WilsonIntervalOfATextbookCase) {
  const Interval i = wilson_interval(8, 10);
  EXPECT_NEAR(i.low, 0.4902, 1e-3);
  EXPECT_NEAR(i.high, 0.9433, 1e-3);
  EXPECT_EQ(wilson_interval(0, 20).low, 0);
  EXPECT_EQ(wilson_interval(20, 20).high, 1);
}

TEST(AveragePixels, InLinearLightAndByCover) {
  // Black and white beside each other are half the light: sRGB 0.735, not 0.5.
  Tensor picture = at::ones({1, 2, 4, 4});
  picture.slice(2, 0, 1).narrow(3, 0, 3).zero_();
  // The right half: a white pixel, the other three see nothing.
  picture.slice(2, 2, 4).zero_();
  picture[0][0][2].fill_(1);
  const Tensor mean = average_pixels(picture, 2);
  ASSERT_EQ(mean.sizes(), at::IntArrayRef({1, 1, 2, 4}));
  EXPECT_NEAR(mean[0][0][0][0].item<double>(), 0.735357, 1e-5);
  EXPECT_NEAR(mean[0][0][0][3].item<double>(), 1, 1e-6);
  EXPECT_NEAR(mean[0][0][1][1].item<double>(), 0.25, 1e-5);  // white, premultiplied
  EXPECT_NEAR(mean[0][0][1][3].item<double>(), 0.25, 1e-6);
  const Tensor flat = at::cat({at::full({1, 9, 9, 3}, 0.02F), at::ones({1, 9, 9, 1})}, 3);
  EXPECT_TRUE(at::allclose(average_pixels(flat, 3), flat.slice(1, 0, 3).slice(2, 0, 3), 1e-4));
}

TEST(CheckRenderer, SamplesOfTheBuiltInOneAreSquares) {
  RendererChoice choice;
  for (const int samples : {0, 1, 4, 9, 64}) {
    choice.samples = samples;
    EXPECT_NO_THROW(check_renderer(choice)) << samples;
  }
  for (const int samples : {2, 8, 81}) {
    choice.samples = samples;
    EXPECT_THROW(check_renderer(choice), InputError) << samples;
  }
  choice.name = "mitsuba";
  EXPECT_NO_THROW(check_renderer(choice));
  EXPECT_EQ(samples_of(choice), 81);
  EXPECT_EQ(samples_of({}), 1);
}

/// 100 pixels a side, at the origin, looking along -z.
Camera front_camera() {
  Camera camera;
  camera.camera_to_world = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
  camera.fx = camera.fy = 100;
  camera.cx = camera.cy = 50;
  camera.width = camera.height = 100;
  return camera;
}

void expect_box(const PixelBox& box, int64_t left, int64_t top, int64_t right, int64_t bottom) {
  EXPECT_EQ(box.left, left);
  EXPECT_EQ(box.top, top);
  EXPECT_EQ(box.right, right);
  EXPECT_EQ(box.bottom, bottom);
}

TEST(ObjectBox, AroundTheProjections) {
  const Tensor corners = at::tensor({-1.0, -0.5, -4.0, 1.0, 1.0, -4.0}).view({2, 3});
  expect_box(object_box(front_camera(), corners), 25, 25, 75, 63);  // y up: 50 - 25 to 50 + 12.5
}

TEST(ObjectBox, SmallOutsideAndBehind) {
  const Tensor speck = at::tensor({0.0, 0.0, -100.0}).view({1, 3});
  const PixelBox box = object_box(front_camera(), speck);
  EXPECT_EQ(box.right - box.left, 11);
  EXPECT_EQ(box.bottom - box.top, 11);
  EXPECT_TRUE(box.left <= 50 && box.right > 50);
  const Tensor left_of_it = at::tensor({-50.0, 0.0, -4.0}).view({1, 3});
  EXPECT_EQ(object_box(front_camera(), left_of_it).left, 0);
  EXPECT_EQ(object_box(front_camera(), left_of_it).right, 11);
  const Tensor behind = at::tensor({0.0, 0.0, -4.0, 0.0, 0.0, 1.0}).view({2, 3});
  expect_box(object_box(front_camera(), behind), 0, 0, 100, 100);
}

TEST(AssetRenderer, ShowsTheTextureAndAntialiasesTheSilhouette) {
  const AssetRenderer renderer(ball(0.2F, 0.6F, 0.8F));
  const auto views = sample_views("ring", 1, 0, 2, 48, {{0, 0, 0}, 1, 3.2, 40});
  const Tensor out = renderer.render({views[0].camera, views[1].camera});
  EXPECT_NEAR(out[0][24][24][2].item<double>(), 0.8, 0.01);
  EXPECT_NEAR(out[0][24][24][3].item<double>(), 1, 1e-6);
  EXPECT_EQ(out[0][0][0].abs().sum().item<double>(), 0);
  const Tensor alpha = out.select(3, 3);
  EXPECT_GT(((alpha > 0.05) & (alpha < 0.95)).sum().item<int64_t>(), 20);
}

TEST(RoundTrip, BakedAndLoadedRendersAsInMemory) {
  // A smooth colour over the surface: bake, write, load, render, compare.
  const testing::Shape s = testing::sphere(4, 0.8F);
  const auto colors = [](const SurfacePoints& points) {
    return (0.5 + 0.35 * at::sin(points.positions * 7)).t().contiguous();
  };
  const Atlas atlas = unwrap(s.vertices, s.faces, 1024, 4, 120);
  TexturedMesh mesh = {s.vertices, s.faces, atlas.uvs, atlas.uv_faces,
                       bake_texture(atlas, s.vertices, s.faces, colors)};
  testing::TemporaryFolder folder;
  write_glb(mesh, folder / "m.glb");
  write_obj(mesh, folder / "m.obj");
  const auto views = sample_views("dome", 1, 0, 4, 128, {{0, 0, 0}, 1, 3.2, 40});
  const RenderMesh prepared(s.faces);
  for (const char* name : {"m.glb", "m.obj"}) {
    const AssetRenderer renderer(load_asset(folder / name));
    for (const SampledView& view : views) {
      const Tensor direct = render_mesh(s.vertices, s.vertices, prepared, {view.camera}, colors)[0];
      const Tensor loaded = renderer.render({view.camera})[0];
      const Tensor white = at::ones({3});
      EXPECT_GT(psnr(over_background(direct, white), over_background(loaded, white)), 35) << name;
    }
  }
}

TEST(EvaluateAsset, FiguresEqualACountByHand) {
  testing::TemporaryFolder folder;
  write_glb(ball(0.9F, 0.1F, 0.1F), folder / "adversarial.glb");
  write_glb(ball(0.1F, 0.9F, 0.1F), folder / "clean.glb");
  EvaluateOptions o;
  o.asset = folder / "adversarial.glb";
  o.clean = folder / "clean.glb";
  o.victims = {kToy};
  o.views = 23;
  o.size = 32;
  Progress quiet;
  // Ask for the class that the toy gives most often, so that both outcomes of a view occur.
  o.target = "3";
  EvalRecord r = evaluate_asset(o, quiet);
  std::map<int64_t, int64_t> votes;
  for (const ViewAnswer& a : r.victims[0].answers) ++votes[a.top1];
  o.target = std::to_string(r.victims[0].answers[0].top1);
  o.true_class = std::to_string(r.victims[0].answers[0].clean_top1);
  r = evaluate_asset(o, quiet);
  const VictimRecord& v = r.victims[0];
  ASSERT_EQ(v.answers.size(), 23U);

  // By hand, from the pictures: render, resize and crop as the card says, ask the model.
  const auto model = Classifier::load(kToy);
  const AssetRenderer adversarial(load_asset(o.asset)), clean(load_asset(o.clean));
  const auto views =
      evaluation_views("dome", 0, 23, 32, asset_view_frame(load_asset(o.asset), o.asset));
  int64_t hits = 0, correct = 0, both = 0;
  double psnr_sum = 0;
  for (const SampledView& view : views) {
    const auto picture = [&](const AssetRenderer& renderer) {
      return (over_background(renderer.render({view.camera})[0], at::ones({3})).clamp(0, 1) * 255)
                 .round() /
             255;
    };
    const auto top1 = [&](const Tensor& x) {
      at::NoGradGuard guard;
      return model
          ->logits(preprocess(x.permute({2, 0, 1}).unsqueeze(0).contiguous(), model->card()))
          .argmax(1)
          .item<int64_t>();
    };
    const bool hit = top1(picture(adversarial)) == r.target.index;
    const bool right = top1(picture(clean)) == r.true_class.index;
    hits += hit;
    correct += right;
    both += hit && right;
    psnr_sum += psnr(picture(adversarial), picture(clean));
  }
  EXPECT_NEAR(v.asr, double(hits) / 23, 1e-12);
  EXPECT_NEAR(*v.clean_accuracy, double(correct) / 23, 1e-12);
  EXPECT_EQ(v.asr_on_correct_n, correct);
  if (correct > 0) {
    EXPECT_NEAR(*v.asr_on_correct, double(both) / double(correct), 1e-12);
  }
  EXPECT_NEAR(*r.psnr, psnr_sum / 23, 1e-6);
  EXPECT_LE(v.asr_ci95.low, v.asr);
  EXPECT_GE(v.asr_ci95.high, v.asr);
}

TEST(EvaluateAsset, RecordHasTheContractsKeys) {
  testing::TemporaryFolder folder;
  write_glb(ball(0.9F, 0.1F, 0.1F), folder / "a.glb");
  EvaluateOptions o;
  o.asset = folder / "a.glb";
  o.victims = {kToy};
  o.target = "teapot";
  o.views = 3;
  o.size = 24;
  Progress quiet;
  write_record(evaluate_asset(o, quiet), folder / "out" / "e.json");
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

TEST(EvaluateAsset, MistakesAreInputErrors) {
  testing::TemporaryFolder folder;
  write_glb(ball(0.9F, 0.1F, 0.1F), folder / "a.glb");
  EvaluateOptions good;
  good.asset = folder / "a.glb";
  good.victims = {kToy};
  good.target = "teapot";
  good.views = 1;
  good.size = 24;
  Progress quiet;
  const auto refuses = [&](const std::function<void(EvaluateOptions&)>& change) {
    EvaluateOptions o = good;
    change(o);
    EXPECT_THROW((void)evaluate_asset(o, quiet), InputError);
  };
  refuses([](EvaluateOptions& o) { o.target = "no such class"; });
  refuses([](EvaluateOptions& o) { o.target = "crane"; });  // ambiguous
  refuses([](EvaluateOptions& o) { o.victims = {"no-such-model"}; });
  refuses([](EvaluateOptions& o) { o.victims = {}; });
  refuses([](EvaluateOptions& o) { o.asset = "/nonexistent.glb"; });
  refuses([](EvaluateOptions& o) { o.view_distribution = "cube"; });
}

TEST(ViewFrameFile, RoundTripAndMalformed) {
  testing::TemporaryFolder folder;
  const TexturedMesh mesh = ball(1, 0, 0);
  write_view_frame({{1, 2, 3}, 4, 5, 60}, folder.path());
  const ViewFrame frame = asset_view_frame(mesh, folder / "a.glb");
  EXPECT_EQ(frame.centre[2], 3);
  EXPECT_EQ(frame.fov_y_deg, 60);
  for (const char* bad : {"", "{}", R"({"centre":[1,2],"radius":1,"distance":1,"fov_y_deg":1})",
                          R"({"centre":[1,2,3],"radius":-1,"distance":1,"fov_y_deg":1})"}) {
    write_file_atomic(folder / "views.json", bad);
    EXPECT_THROW((void)asset_view_frame(mesh, folder / "a.glb"), InputError) << bad;
  }
}

TEST(RenderToFolder, ReadsBackAsACaptureWithTheSameViews) {
  testing::TemporaryFolder folder;
  write_glb(ball(0.2F, 0.6F, 0.8F), folder / "a.glb");
  Progress quiet;
  render_to_folder(folder / "a.glb", "dome", 6, 48, 3, folder / "views", quiet);
  CaptureOptions o;
  o.path = folder / "views";
  o.format = "nerf-synthetic";
  const Capture capture = load_capture(o, quiet);
  EXPECT_EQ(capture.train.size(), 6U);
  EXPECT_TRUE(capture.has_masks);
  const Tensor middle = capture.train[0].rgba[24][24];
  EXPECT_NEAR(middle[2].item<double>(), 204, 2);
}

}  // namespace
}  // namespace tt3d
