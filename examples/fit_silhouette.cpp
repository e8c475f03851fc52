// A minimal example of inverse rendering: a sphere's vertices move until its silhouettes match
// those of a larger one. Shows the rasteriser's gradients (docs/raster.md) and how to write an
// asset.
//
//   fit_silhouette OUT.glb
#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>
#include <torch/csrc/autograd/autograd.h>

#include <cstdio>
#include <exception>

#include "tt3d/asset.h"
#include "tt3d/error.h"
#include "tt3d/mesh.h"

namespace {

using at::Tensor;

/// A ball of the given radius around the origin, by marching cubes.
tt3d::scene::TriMesh ball(double radius) {
  const Tensor axis = at::linspace(-1, 1, 25);
  const auto xyz = at::meshgrid({axis, axis, axis}, "ij");
  const Tensor distance = (xyz[0].square() + xyz[1].square() + xyz[2].square()).sqrt();
  return tt3d::mesh::marching_cubes(radius - distance);
}

/// Coverage of each pixel in each view, [N,H,W].
Tensor silhouettes(const Tensor& vertices, const tt3d::mesh::RenderMesh& mesh,
                   const std::vector<tt3d::scene::Camera>& cameras) {
  const auto white = [](const tt3d::raster::SurfacePoints& points) {
    return at::ones({3, points.positions.size(0)});
  };
  return tt3d::mesh::render_mesh(vertices, vertices, mesh, cameras, white).select(3, 3);
}

void fit(const std::filesystem::path& out) {
  const tt3d::scene::TriMesh wanted = ball(0.7), start = ball(0.5);
  const tt3d::mesh::RenderMesh wanted_mesh(wanted.faces), mesh(start.faces);
  Tensor vertices = start.vertices.clone().requires_grad_(true);
  double first = 0, last = 0;
  constexpr int kSteps = 120, kViews = 4, kSize = 64;
  for (int step = 0; step < kSteps; ++step) {
    std::vector<tt3d::scene::Camera> cameras;
    for (const tt3d::scene::SampledView& view :
         tt3d::scene::sample_views(tt3d::scene::ViewDistribution::kSphere, /*seed=*/1,
                                   step * kViews, kViews, kSize, {})) {
      cameras.push_back(view.camera);
    }
    const Tensor loss =
        (silhouettes(vertices, mesh, cameras) - silhouettes(wanted.vertices, wanted_mesh, cameras))
            .square()
            .mean();
    const Tensor gradient = torch::autograd::grad({loss}, {vertices})[0];
    at::NoGradGuard guard;
    // Uses the sign only: a silhouette tells a vertex the direction, not the distance.
    vertices.sub_(0.005 * gradient.sign());
    last = loss.item<double>();
    if (step == 0) first = last;
  }
  std::printf("silhouette error %.4f -> %.4f\n", first, last);
  const int64_t count = start.vertices.size(0);
  tt3d::asset::write_glb({vertices.detach(), start.faces, at::full({count, 2}, 0.5), start.faces,
                          at::full({4, 4, 3}, 200, at::kByte)},
                         out);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "usage: fit_silhouette OUT.glb\n");
    return 2;
  }
  try {
    fit(argv[1]);
  } catch (const tt3d::Error& error) {
    std::fprintf(stderr, "fit_silhouette: %s\n", error.what());
    return error.exit_code();
  }
}
