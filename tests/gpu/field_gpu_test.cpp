#include <gtest/gtest.h>

#include <cmath>

#include "field/rays.h"
#include "gpu/both_devices.h"
#include "support/stop_after.h"
#include "support/synthetic_capture.h"
#include "support/temporary_folder.h"
#include "tt3d/capture.h"
#include "tt3d/field.h"
#include "tt3d/gpu_options.h"
#include "tt3d/optimize.h"
#include "tt3d/random_tensor.h"
#include "tt3d/scene.h"

namespace tt3d {
namespace {

using at::Tensor;
using testing::expect_same;
using testing::relative_difference;
using testing::uniform;

struct FieldOnGpu : testing::OnGpu {};

field::HashGridShape small_shape(int64_t features) { return {4, 4, 40, 9, features}; }

field::FieldOptions small_options(at::Device device) {
  field::FieldOptions o;
  o.shape.geometry = {6, 8, 64, 12, 1};
  o.shape.appearance = {6, 8, 64, 12, 2};
  o.shape.occupancy = 32;
  o.steps = 60;
  o.samples_per_step = 8192;
  o.ray_steps = 96;
  o.checkpoint_every = 7;
  o.device = device;
  return o;
}

TEST_F(FieldOnGpu, RandomTensorsHaveTheSameBytes) {
  const RandomKey key = Random(5, "test", 3).key();
  const at::Device cpu = at::kCPU;
  EXPECT_TRUE(at::equal(uniform_tensor({1003}, key, cpu), uniform_tensor({1003}, key, gpu).cpu()));
  EXPECT_TRUE(at::equal(uniform_tensor({1003}, -2, 3, key, cpu),
                        uniform_tensor({1003}, -2, 3, key, gpu).cpu()));
  EXPECT_TRUE(at::equal(noise_tensor({1003}, key, cpu), noise_tensor({1003}, key, gpu).cpu()));
}

TEST_F(FieldOnGpu, HashEncodeAndItsGradients) {
  for (const int64_t features : {1, 2}) {
    const field::HashGridShape shape = small_shape(features);
    Tensor x = uniform({5000, 3}, -1, 1, 1);
    x[0].fill_(1);
    x[1].fill_(-1);
    x[2].fill_(1.5);
    const Tensor table = uniform({shape.entries(), features}, -1, 1, 2);
    const auto encode = [&](const auto& in) { return field::hash_encode(in[0], in[1], shape); };
    expect_same("double", gpu, encode, {x, table}, 1e-11);
    expect_same("float", gpu, encode, {x.to(at::kFloat), table.to(at::kFloat)}, 1e-4);
  }
}

TEST_F(FieldOnGpu, HashEncodeOfTheOfficialShapeAndOfNoPoints) {
  const field::HashGridShape shape;
  const Tensor table = uniform({shape.entries(), 2}, -1, 1, 2).to(at::kFloat);
  const auto encode = [&](const auto& in) { return field::hash_encode(in[0], in[1], shape); };
  expect_same("official", gpu, encode, {uniform({100000, 3}, -1, 1, 1).to(at::kFloat), table},
              1e-4);
  expect_same("empty", gpu, encode, {at::empty({0, 3}), table}, 0);
}

TEST_F(FieldOnGpu, MlpAndItsGradients) {
  for (const int64_t count : {0, 1, 127, 9000}) {
    const auto network = [](const auto& in) { return field::mlp(in[0], {in[1], in[2], in[3]}); };
    const std::vector<Tensor> inputs = {uniform({7, count}, -1, 1, 9), uniform({19, 7}, -1, 1, 6),
                                        uniform({13, 19}, -1, 1, 7), uniform({3, 13}, -1, 1, 8)};
    expect_same("double", gpu, network, inputs, 1e-10);
  }
}

TEST_F(FieldOnGpu, HalfMlpRoundsAsOnTheCpu) {
  // The field's three MLPs, one with the maximum number of layers, and one with a single unit.
  for (const auto& widths : std::vector<std::vector<int64_t>>{
           {35, 64, 64, 6}, {19, 32, 1}, {6, 32, 3}, {7, 19, 13, 33, 3}, {1, 1}}) {
    for (const int64_t count : {1, 15, 129, 1000, 70000}) {
      std::vector<Tensor> inputs = {uniform({widths[0], count}, -1, 1, 9).to(at::kFloat)};
      for (size_t k = 0; k + 1 < widths.size(); ++k) {
        const double bound = std::sqrt(3.0 / static_cast<double>(widths[k]));
        inputs.push_back(uniform({widths[k + 1], widths[k]}, -bound, bound, 6 + k).to(at::kFloat));
      }
      const auto network = [](const auto& in) {
        return field::half_mlp(in[0], std::vector<Tensor>(in.begin() + 1, in.end()));
      };
      // Sums in another order may round an activation differently, e.g. to 0 or not.
      expect_same("half_mlp", gpu, network, inputs, 2e-3, testing::relative_length);
    }
  }
}

TEST_F(FieldOnGpu, HalfMlpsFitABallAsWell) {
  const capture::Capture capture = testing::ball_capture(24, 40);
  field::FieldOptions o = small_options(gpu);
  o.steps = 250;
  Progress quiet;
  testing::TemporaryFolder folder;
  use_gpu_options({.half_mlp = true});
  const field::RadianceField f = field::fit_field(capture, o, 1, folder / "c.safetensors", quiet);
  const double psnr = capture::mean_psnr(
      capture.test,
      [&](const scene::Camera& c) { return field::render_field(f, c, field::ray_step(o)); }, quiet);
  use_gpu_options({});
  EXPECT_GT(psnr, 24);
}

TEST_F(FieldOnGpu, CompositeAndItsGradients) {
  const Tensor begin = at::tensor({0, 3, 3, 500, 1000}, at::kLong);
  const Tensor densities = uniform({1000}, 0, 9, 14), colors = uniform({3, 1000}, 0, 1, 15);
  const Tensor steps = uniform({1000}, 0.01, 0.1, 16);
  for (const auto& [dtype, tolerance] :
       {std::pair{at::kDouble, 1e-10}, std::pair{at::kFloat, 1e-4}}) {
    expect_same(
        "composite", gpu,
        [&](const auto& in) {
          return field::composite(in[0], in[1], steps.to(in[0].options()),
                                  begin.to(in[0].device()));
        },
        {densities.to(dtype), colors.to(dtype)}, tolerance);
  }
}

TEST_F(FieldOnGpu, MarchedAndVisibleSamplesAreTheSame) {
  const Tensor occupied = (uniform({32, 32, 32}, 0, 1, 41) > 0.8).to(at::kByte);
  const Tensor origins = uniform({3000, 3}, -2, 2, 42).to(at::kFloat);
  Tensor directions = uniform({3000, 3}, -1, 1, 43).to(at::kFloat);
  directions[0] = at::tensor({0.F, 0.F, 1.F});
  directions = directions / directions.norm(2, {1}, true);
  const Tensor jitter = uniform({3000}, 0, 1, 44).to(at::kFloat);
  const field::RaySamples a = field::march_rays(origins, directions, occupied, jitter, 0.02, 0.05);
  const field::RaySamples b = field::march_rays(origins.to(gpu), directions.to(gpu),
                                                occupied.to(gpu), jitter.to(gpu), 0.02, 0.05);
  EXPECT_TRUE(at::equal(a.ray_begin, b.ray_begin.cpu()));
  EXPECT_TRUE(at::equal(a.points, b.points.cpu()));
  const Tensor densities = uniform({a.points.size(0)}, 0, 30, 45).to(at::kFloat);
  const auto [kept_a, begin_a] = field::visible_samples(densities, a.steps, a.ray_begin, 1e-3);
  const auto [kept_b, begin_b] =
      field::visible_samples(densities.to(gpu), b.steps, b.ray_begin, 1e-3);
  EXPECT_TRUE(at::equal(kept_a, kept_b.cpu()));
  EXPECT_TRUE(at::equal(begin_a, begin_b.cpu()));
  const Tensor none = at::zeros({32, 32, 32}, at::kByte).to(gpu);
  EXPECT_EQ(field::march_rays(b.points.new_zeros({4, 3}), directions.narrow(0, 0, 4).to(gpu), none,
                              jitter.narrow(0, 0, 4).to(gpu), 0.02, 0.05)
                .points.size(0),
            0);
}

TEST_F(FieldOnGpu, RaysOfCapturesAreTheSame) {
  const capture::Capture capture = testing::ball_capture(8, 24);
  const auto a = field::make_pixel_pool(capture.train, 32, at::kCPU);
  const auto b = field::make_pixel_pool(capture.train, 32, gpu);
  const field::Rays x = field::random_rays(a, 5001, 1, 2), y = field::random_rays(b, 5001, 1, 2);
  EXPECT_TRUE(at::equal(x.origins, y.origins.cpu()));
  EXPECT_TRUE(at::equal(x.directions, y.directions.cpu()));
  EXPECT_TRUE(at::equal(x.targets, y.targets.cpu()));
  const scene::Camera& camera = capture.train[0].camera;
  EXPECT_TRUE(at::equal(field::row_rays(camera, 3, 9, at::kCPU).directions,
                        field::row_rays(camera, 3, 9, gpu).directions.cpu()));
}

TEST_F(FieldOnGpu, AdamMovesTheSame) {
  const Tensor start = uniform({1000}, -1, 1, 51).to(at::kFloat);
  Tensor gradient = uniform({1000}, -1, 1, 52).to(at::kFloat);
  gradient.narrow(0, 0, 100).zero_();
  std::vector<Tensor> results;
  for (const at::Device& device : {at::Device(at::kCPU), gpu}) {
    const Tensor p = start.to(device, at::kFloat, false, true);
    const Tensor m = at::zeros_like(p), v = at::zeros_like(p);
    for (int64_t i = 1; i <= 5; ++i) optimize::Adam{}.step(p, gradient.to(device), m, v, 0.01, i);
    results.push_back(p.cpu());
  }
  EXPECT_LE(relative_difference(results[0], results[1]), 1e-6);
  EXPECT_TRUE(at::equal(results[0].narrow(0, 0, 100), start.narrow(0, 0, 100)));
}

TEST_F(FieldOnGpu, OccupancyIsTheSame) {
  const capture::Capture capture = testing::ball_capture(8, 24);
  field::FieldShape shape = small_options(gpu).shape;
  std::vector<Tensor> results;
  for (const at::Device& device : {at::Device(at::kCPU), gpu}) {
    field::RadianceField f = field::RadianceField::create(shape, 3).to(device);
    field::OccupancyGrid grid;
    grid.hull = field::visual_hull(capture.train, shape.occupancy).to(device);
    grid.density = grid.hull.to(at::kFloat);
    grid.refresh(f, 1, 16);
    results.push_back(grid.density.cpu());
  }
  EXPECT_LE(relative_difference(results[0], results[1]), 1e-4);
}

TEST_F(FieldOnGpu, FitsABall) {
  const capture::Capture capture = testing::ball_capture(24, 40);
  field::FieldOptions o = small_options(gpu);
  o.steps = 250;
  Progress quiet;
  testing::TemporaryFolder folder;
  const field::RadianceField f = field::fit_field(capture, o, 1, folder / "c.safetensors", quiet);
  EXPECT_EQ(f.device(), gpu);
  const double psnr = capture::mean_psnr(
      capture.test,
      [&](const scene::Camera& c) { return field::render_field(f, c, field::ray_step(o)); }, quiet);
  EXPECT_GT(psnr, 24);
  // The same field, rendered on the CPU.
  const field::RadianceField on_cpu = f.to(at::kCPU);
  const scene::Camera& camera = capture.test[0].camera;
  EXPECT_LE(relative_difference(field::render_field(on_cpu, camera, field::ray_step(o)),
                                field::render_field(f, camera, field::ray_step(o))),
            2e-2);
}

TEST_F(FieldOnGpu, AStoppedFitGoesOn) {
  const capture::Capture capture = testing::ball_capture(8, 24);
  Progress quiet;
  testing::TemporaryFolder folder;
  testing::StopAfter stop(20);
  EXPECT_THROW((void)field::fit_field(capture, small_options(gpu), 1, folder / "c", stop),
               Interrupted);
  // Either device can load a checkpoint of the other.
  testing::StopAfter again(20);
  EXPECT_THROW((void)field::fit_field(capture, small_options(at::kCPU), 1, folder / "c", again),
               Interrupted);
  const field::RadianceField f =
      field::fit_field(capture, small_options(gpu), 1, folder / "c", quiet);
  for (const Tensor& p : f.parameters()) EXPECT_TRUE(p.isfinite().all().item<bool>());
}

}  // namespace
}  // namespace tt3d
