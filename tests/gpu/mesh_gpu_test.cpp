#include <gtest/gtest.h>

#include "gpu/both_devices.h"
#include "support/synthetic_capture.h"
#include "support/temporary_folder.h"
#include "tt3d/mesh.h"

namespace tt3d {
namespace {

using at::Tensor;
using testing::expect_same;

struct MeshOnGpu : testing::OnGpu {};

GridMlp small_appearance() {
  FieldShape shape;
  shape.geometry = {2, 4, 8, 8, 1};
  shape.appearance = {6, 8, 64, 12, 2};
  shape.occupancy = 8;
  return RadianceField::create(shape, 1).appearance;
}

TEST_F(MeshOnGpu, RegularisersAndTheirGradients) {
  const testing::Shape shape = testing::sphere(3);
  const TriMesh mesh = {shape.vertices, shape.faces};
  // Near the rest place every nearest vertex is known; far from it they are searched.
  for (const double distance : {0.001, 0.6}) {
    const Tensor moved =
        shape.vertices +
        testing::uniform(shape.vertices.sizes(), -distance, distance, 4).to(at::kFloat);
    const MeshRegularizer on_cpu(mesh), on_gpu(mesh.to(gpu));
    const auto measure = [&](auto member) {
      return [&, member](const std::vector<Tensor>& in) {
        return ((in[0].is_cpu() ? on_cpu : on_gpu).*member)(in[0]);
      };
    };
    expect_same("laplacian", gpu, measure(&MeshRegularizer::laplacian), {moved}, 1e-4);
    expect_same("edge length", gpu, measure(&MeshRegularizer::edge_length), {moved}, 1e-4);
    expect_same("chamfer", gpu, measure(&MeshRegularizer::chamfer), {moved}, 1e-4);
  }
}

TEST_F(MeshOnGpu, RenderingAndItsGradients) {
  const testing::Shape shape = testing::sphere(3, 0.7F);
  const RenderMesh on_cpu(shape.faces), on_gpu(shape.faces.to(gpu));
  const GridMlp look_cpu = small_appearance(), look_gpu = look_cpu.to(gpu);
  std::vector<Camera> cameras;
  for (const SampledView& v : sample_views("dome", 3, 0, 3, 64, {{0, 0, 0}, 1, 3.2, 40})) {
    cameras.push_back(v.camera);
  }
  expect_same(
      "render_mesh", gpu,
      [&](const std::vector<Tensor>& in) {
        const bool cpu = in[0].is_cpu();
        const GridMlp& look = cpu ? look_cpu : look_gpu;
        return render_mesh(in[0], in[0], cpu ? on_cpu : on_gpu, cameras,
                           [&](const SurfacePoints& p) { return look.color(p.positions); });
      },
      {shape.vertices}, 2e-2);
}

TEST_F(MeshOnGpu, RefinesTheBall) {
  const Capture capture = testing::ball_capture(16, 40);
  const testing::Shape start = testing::sphere(3, 0.55F);
  Progress quiet;
  testing::TemporaryFolder folder;
  MeshOptions o;
  o.refine_steps = 120;
  o.vertex_rate = 2e-3;
  o.offset_weight = 0;
  o.mask_weight = 1;
  o.min_faces = 100;
  o.max_faces = 5000;
  o.min_edge = 0.005;
  const RefinedMesh r = refine_mesh({start.vertices, start.faces}, small_appearance().to(gpu),
                                    capture, o, 1, folder / "c", quiet);
  EXPECT_EQ(r.mesh.vertices.device(), gpu);
  EXPECT_TRUE(inspect(r.mesh).closed());
  EXPECT_NEAR(r.mesh.vertices.norm(2, {1}).mean().item<double>(), 0.6, 0.02);
}

}  // namespace
}  // namespace tt3d
