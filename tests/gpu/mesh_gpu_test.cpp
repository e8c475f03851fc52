#include <gtest/gtest.h>

#include "gpu/both_devices.h"
#include "support/synthetic_capture.h"
#include "support/temporary_folder.h"
#include "tt3d/capture.h"
#include "tt3d/image.h"
#include "tt3d/mesh.h"
#include "tt3d/raster.h"
#include "tt3d/scene.h"
#include "tt3d/surface.h"

namespace tt3d {
namespace {

using at::Tensor;
using testing::expect_same;

struct MeshOnGpu : testing::OnGpu {};

field::GridMlp small_appearance() {
  field::FieldShape shape;
  shape.geometry = {2, 4, 8, 8, 1};
  shape.appearance = {6, 8, 64, 12, 2};
  shape.occupancy = 8;
  return field::RadianceField::create(shape, 1).appearance;
}

TEST_F(MeshOnGpu, PhotographsAreConvertedToTheBytesOfTheCpu) {
  const Tensor rgba = testing::uniform({64, 80, 4}, 0, 256, 3).to(at::kByte);
  EXPECT_TRUE(at::equal(image::premultiplied(rgba), image::premultiplied(rgba.to(gpu)).cpu()));
}

TEST_F(MeshOnGpu, RegularisersAndTheirGradients) {
  const testing::Shape shape = testing::sphere(3);
  const scene::TriMesh mesh = {shape.vertices, shape.faces};
  // Near the rest position no vertex needs a search; far from it all do.
  for (const double distance : {0.001, 0.6}) {
    const Tensor moved =
        shape.vertices +
        testing::uniform(shape.vertices.sizes(), -distance, distance, 4).to(at::kFloat);
    const mesh::MeshRegularizer on_cpu(mesh), on_gpu(mesh.to(gpu));
    const auto measure = [&](auto member) {
      return [&, member](const std::vector<Tensor>& in) {
        return ((in[0].is_cpu() ? on_cpu : on_gpu).*member)(in[0]);
      };
    };
    expect_same("laplacian", gpu, measure(&mesh::MeshRegularizer::laplacian), {moved}, 1e-4);
    expect_same("edge length", gpu, measure(&mesh::MeshRegularizer::edge_length), {moved}, 1e-4);
    expect_same("chamfer", gpu, measure(&mesh::MeshRegularizer::chamfer), {moved}, 1e-4);
  }
}

TEST_F(MeshOnGpu, RenderingAndItsGradients) {
  const testing::Shape shape = testing::sphere(3, 0.7F);
  const mesh::RenderMesh on_cpu(shape.faces), on_gpu(shape.faces.to(gpu));
  const field::GridMlp appearance_cpu = small_appearance(), appearance_gpu = appearance_cpu.to(gpu);
  std::vector<scene::Camera> cameras;
  for (const scene::SampledView& v :
       scene::sample_views(scene::ViewDistribution::kDome, 3, 0, 3, 64, {{0, 0, 0}, 1, 3.2, 40})) {
    cameras.push_back(v.camera);
  }
  expect_same(
      "render_mesh", gpu,
      [&](const std::vector<Tensor>& in) {
        const bool cpu = in[0].is_cpu();
        const field::GridMlp& appearance = cpu ? appearance_cpu : appearance_gpu;
        return mesh::render_mesh(
            in[0], in[0], cpu ? on_cpu : on_gpu, cameras,
            [&](const raster::SurfacePoints& p) { return appearance.color(p.positions); });
      },
      {shape.vertices}, 2e-2);
}

TEST_F(MeshOnGpu, RefinesTheBall) {
  const capture::Capture capture = testing::ball_capture(16, 40);
  const testing::Shape start = testing::sphere(3, 0.55F);
  Progress quiet;
  testing::TemporaryFolder folder;
  mesh::MeshOptions o;
  o.refine_steps = 120;
  o.vertex_rate = 2e-3;
  o.offset_weight = 0;
  o.mask_weight = 1;
  o.min_faces = 100;
  o.max_faces = 5000;
  o.min_edge = 0.005;
  const object::Object r =
      mesh::refine_mesh({start.vertices, start.faces}, small_appearance().to(gpu), capture, o, 1,
                        folder / "c", quiet);
  EXPECT_EQ(r.mesh.vertices.device(), gpu);
  EXPECT_TRUE(mesh::inspect(r.mesh).closed());
  EXPECT_NEAR(r.mesh.vertices.norm(2, {1}).mean().item<double>(), 0.6, 0.02);
}

}  // namespace
}  // namespace tt3d
