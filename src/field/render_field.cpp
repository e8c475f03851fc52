#include <ATen/ATen.h>

#include <cmath>

#include "rays.h"
#include "tt3d/field.h"

namespace tt3d {

using at::Tensor;

Tensor render_field(const RadianceField& f, const Camera& camera, double step) {
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

Tensor premultiplied(const View& view) {
  const Tensor rgba = view.rgba.to(at::kFloat) / 255;
  const Tensor alpha = rgba.narrow(2, 3, 1);
  return at::cat({rgba.narrow(2, 0, 3) * alpha, alpha}, 2);
}

Tensor over_background(const Tensor& rgba, const Tensor& background) {
  return rgba.narrow(-1, 0, 3) + (1 - rgba.narrow(-1, 3, 1)) * background;
}

double mean_psnr(const std::vector<View>& views, const ViewRenderer& render, Progress& progress) {
  progress.begin("test views", static_cast<int64_t>(views.size()), 0);
  const Tensor white = at::ones({3});
  double sum = 0;
  for (size_t i = 0; i < views.size(); ++i) {
    const Tensor difference = over_background(render(views[i].camera).cpu(), white).clamp(0, 1) -
                              over_background(premultiplied(views[i]), white);
    sum += -10 * std::log10(std::max(1e-10, difference.square().mean().item<double>()));
    progress.update(static_cast<int64_t>(i) + 1, {{"psnr", sum / static_cast<double>(i + 1)}});
    progress.check();
  }
  progress.end();
  return views.empty() ? 0 : sum / static_cast<double>(views.size());
}

}  // namespace tt3d
