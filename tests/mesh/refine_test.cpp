#include <ATen/core/grad_mode.h>
#include <gtest/gtest.h>

#include "support/count_notes.h"
#include "support/shapes.h"
#include "support/stop_after.h"
#include "support/synthetic_capture.h"
#include "support/temporary_folder.h"
#include "tt3d/capture.h"
#include "tt3d/memory.h"
#include "tt3d/mesh.h"
#include "tt3d/raster.h"
#include "tt3d/scene.h"
#include "tt3d/surface.h"

namespace tt3d::mesh {
namespace {

using at::Tensor;

MeshOptions small_options() {
  MeshOptions o;
  o.refine_steps = 40;
  o.vertex_rate = 1e-3;
  o.min_faces = 100;
  o.max_faces = 5000;
  o.checkpoint_every = 6;
  o.min_edge = 0.005;
  return o;
}

field::GridMlp small_appearance() {
  field::FieldShape shape;
  shape.geometry = {2, 4, 8, 8, 1};
  shape.appearance = {6, 8, 64, 12, 2};
  shape.occupancy = 8;
  return field::RadianceField::create(shape, 1).appearance;
}

TEST(RefineMesh, FindsTheBallFromATooSmallOne) {
  const capture::Capture capture = testing::ball_capture(16, 40);
  const testing::Shape start = testing::sphere(3, 0.55F);
  Progress quiet;
  testing::TemporaryFolder folder;
  MeshOptions o = small_options();
  o.refine_steps = 120;
  o.vertex_rate = 2e-3;
  o.offset_weight = 0;
  o.mask_weight = 1;
  const object::Object r = refine_mesh({start.vertices, start.faces}, small_appearance(), capture,
                                       o, 1, folder / "c", quiet);
  const MeshFacts facts = inspect(r.mesh);
  EXPECT_TRUE(facts.closed());
  EXPECT_NE(facts.faces, start.faces.size(0));  // faces were split or thinned
  EXPECT_NEAR(r.mesh.vertices.norm(2, {1}).mean().item<double>(), 0.6, 0.02);
  const RenderMesh prepared(r.mesh.faces);
  at::NoGradGuard guard;
  const double psnr = capture::mean_psnr(
      capture.test,
      [&](const scene::Camera& camera) {
        return render_mesh(
            r.mesh.vertices, r.mesh.vertices, prepared, {camera},
            [&](const raster::SurfacePoints& p) { return r.appearance->color(p); })[0];
      },
      quiet);
  EXPECT_GT(psnr, 24);
}

TEST(RefineMesh, ResumedAfterAnyStopGivesTheSameBytes) {
  const capture::Capture capture = testing::ball_capture(8, 24);
  const testing::Shape start = testing::sphere(3, 0.58F);
  const scene::TriMesh mesh = {start.vertices, start.faces};
  Progress quiet;
  testing::TemporaryFolder folder;
  const MeshOptions o = small_options();
  const object::Object whole =
      refine_mesh(mesh, small_appearance(), capture, o, 1, folder / "whole", quiet);
  Random random(6, "stops");
  for (int stops = 0; stops < 4; ++stops) {
    // 36 steps at most: every stop comes before the end.
    testing::StopAfter stop(static_cast<int>(1 + random.index(9)));
    EXPECT_THROW(
        (void)refine_mesh(mesh, small_appearance(), capture, o, 1, folder / "stopped", stop),
        Interrupted)
        << stops;
  }
  const object::Object again =
      refine_mesh(mesh, small_appearance(), capture, o, 1, folder / "stopped", quiet);
  EXPECT_TRUE(at::equal(whole.mesh.vertices, again.mesh.vertices));
  EXPECT_TRUE(at::equal(whole.mesh.faces, again.mesh.faces));
  EXPECT_TRUE(at::equal(whole.appearance->parameters()[0], again.appearance->parameters()[0]));
}

TEST(RefineMesh, PhotographsStayInEightBits) {
  // 13 million pixels; as float32 they would take 210 MB.
  const capture::Capture capture = testing::ball_capture(267, 256);
  const testing::Shape start = testing::sphere(3, 0.55F);
  Progress quiet;
  testing::TemporaryFolder folder;
  MeshOptions o = small_options();
  o.refine_steps = 2;
  reset_peak_memory();
  const int64_t before = peak_memory_bytes();
  (void)refine_mesh({start.vertices, start.faces}, small_appearance(), capture, o, 1, folder / "c",
                    quiet);
  EXPECT_LT(peak_memory_bytes() - before, int64_t{120} << 20);
}

TEST(RefineMesh, DivergenceRollsBackThreeTimesAndThenStops) {
  const capture::Capture capture = testing::ball_capture(4, 16);
  const testing::Shape start = testing::sphere(2, 0.58F);
  MeshOptions o = small_options();
  o.vertex_rate = 1e30;  // vertices overflow at once
  testing::CountNotes notes;
  testing::TemporaryFolder folder;
  EXPECT_THROW((void)refine_mesh({start.vertices, start.faces}, small_appearance(), capture, o, 1,
                                 folder / "c", notes),
               NumericError);
  EXPECT_EQ(notes.count, 3);
}

TEST(ExtractMesh, EmptyFieldIsAnInputError) {
  field::FieldShape shape;
  shape.geometry = {2, 4, 8, 8, 1};
  shape.appearance = {2, 4, 8, 8, 2};
  shape.occupancy = 16;
  field::RadianceField f = field::RadianceField::create(shape, 1);
  f.occupied.zero_();
  MeshOptions o;
  o.resolution = 24;
  Progress quiet;
  EXPECT_THROW((void)extract_mesh(f, o, quiet), InputError);
}

}  // namespace
}  // namespace tt3d::mesh
