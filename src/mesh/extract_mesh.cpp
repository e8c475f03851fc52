#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>

#include <cmath>

#include "tt3d/device.h"
#include "tt3d/mesh.h"
#include "tt3d/surface.h"

namespace tt3d::mesh {
namespace {

using at::Tensor;

/// Whether each grid point lies in an occupied cell or next to one. The density is evaluated only
/// there.
Tensor candidate_points(const Tensor& occupied, int64_t resolution) {
  const int64_t cells = occupied.size(0);
  const Tensor wide = at::max_pool3d(occupied.to(at::kFloat).unsqueeze(0).unsqueeze(0), {3, 3, 3},
                                     {1, 1, 1}, {1, 1, 1})
                          .squeeze(0)
                          .squeeze(0)
                          .to(at::kByte)
                          .contiguous();
  const auto* w = wide.const_data_ptr<uint8_t>();
  Tensor out = at::empty({resolution * resolution * resolution}, at::kByte);
  auto* p = out.mutable_data_ptr<uint8_t>();
  for_each_index(out.numel(), [&](int64_t i) {
    const int64_t c[3] = {i % resolution, i / resolution % resolution, i / resolution / resolution};
    int64_t cell[3];
    for (int k = 0; k < 3; ++k) cell[k] = std::min(cells - 1, c[k] * cells / (resolution - 1));
    p[i] = w[(cell[2] * cells + cell[1]) * cells + cell[0]];
  });
  return out;
}

Tensor grid_positions(const Tensor& index, int64_t resolution) {
  const auto* n = index.const_data_ptr<int64_t>();
  Tensor points = at::empty({index.size(0), 3});
  auto* p = points.mutable_data_ptr<float>();
  const float scale = 2.0F / static_cast<float>(resolution - 1);
  for_each_index(index.size(0), [&](int64_t i) {
    const int64_t c[3] = {n[i] % resolution, n[i] / resolution % resolution,
                          n[i] / resolution / resolution};
    for (int k = 0; k < 3; ++k) p[3 * i + k] = static_cast<float>(c[k]) * scale - 1;
  });
  return points;
}

/// log(density / iso) at the grid points, clamped, and smoothed by binomial filters. The density
/// spans many decades, and noise of a single cell would make handles that no later step removes.
Tensor log_density_grid(const field::RadianceField& f, const MeshOptions& options,
                        Progress& progress) {
  at::NoGradGuard guard;
  const int64_t g = options.resolution;
  const Tensor index = candidate_points(f.occupied.cpu(), g).nonzero().flatten();
  Tensor density = at::zeros({g * g * g});
  constexpr int64_t kChunk = 1 << 19;
  progress.begin("density grid", index.size(0), 0);
  for (int64_t i = 0; i < index.size(0); i += kChunk) {
    const Tensor part = index.narrow(0, i, std::min(kChunk, index.size(0) - i));
    density.index_copy_(0, part, f.density(grid_positions(part, g).to(f.device())).cpu());
    progress.update(std::min(index.size(0), i + kChunk), {});
    progress.check();
  }
  progress.end();
  const double mean = index.size(0) > 0 ? density.index_select(0, index).mean().item<double>() : 0;
  const double iso = std::max(1e-3, std::min(options.iso, mean));
  constexpr double kBound = 4;
  Tensor values = ((density + 1e-9) / iso).log_().clamp_(-kBound, kBound).view({1, 1, g, g, g});
  const Tensor kernel = at::tensor({0.25F, 0.5F, 0.25F});
  constexpr int kPasses = 2;
  for (int pass = 0; pass < 3 * kPasses; ++pass) {
    const int axis = pass % 3;
    std::vector<int64_t> shape = {1, 1, 1, 1, 1}, pad = {0, 0, 0};
    shape[2 + axis] = 3;
    pad[axis] = 1;
    values = at::conv3d(values, kernel.view(shape), {}, {1, 1, 1}, pad);
  }
  return values.view({g, g, g}).contiguous();
}

}  // namespace

scene::TriMesh extract_mesh(const field::RadianceField& field, const MeshOptions& options,
                            Progress& progress) {
  const Tensor values = log_density_grid(field, options, progress);
  fill_cavities(values, options.close_gaps);
  scene::TriMesh mesh = marching_cubes(values);
  if (mesh.faces.size(0) == 0) {
    throw InputError("the field contains nothing solid: no surface at density " +
                     std::to_string(options.iso) +
                     "; train longer (field.steps) or lower mesh.iso");
  }
  mesh = drop_small_components(mesh, options.min_component);
  mesh = simplify(mesh, options.target_faces);
  return drop_small_components(mesh, options.min_component);
}

}  // namespace tt3d::mesh
