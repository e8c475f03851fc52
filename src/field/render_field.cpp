#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>

#include <cmath>

#include "rays.h"
#include "tt3d/field.h"
#include "tt3d/scene.h"

namespace tt3d::field {

using at::Tensor;

Tensor render_field(const RadianceField& f, const scene::Camera& camera, double step) {
  at::NoGradGuard guard;
  constexpr int64_t kRaysAtOnce = 32768;
  const int64_t rows = std::max<int64_t>(1, kRaysAtOnce / camera.width);
  std::vector<Tensor> parts;
  for (int64_t row = 0; row < camera.height; row += rows) {
    const field::Rays rays =
        field::row_rays(camera, row, std::min<int64_t>(camera.height, row + rows), f.device());
    const Tensor jitter = at::full({rays.origins.size(0)}, 0.5F, rays.origins.options());
    parts.push_back(field::render_rays(f, rays, jitter, step, true, nullptr, nullptr));
  }
  return at::cat(parts).view({camera.height, camera.width, 4});
}

}  // namespace tt3d::field
