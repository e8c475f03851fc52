#include <ATen/ATen.h>

#include "tt3d/capture.h"
#include "tt3d/image.h"

namespace tt3d::capture {

using at::Tensor;

double mean_psnr(const std::vector<View>& views, const ViewRenderer& render, Progress& progress) {
  progress.begin("test views", static_cast<int64_t>(views.size()), 0);
  const Tensor white = at::ones({3});
  double sum = 0;
  for (size_t i = 0; i < views.size(); ++i) {
    const Tensor shown = image::over_background(render(views[i].camera).cpu(), white).clamp(0, 1);
    sum += image::psnr(shown, image::over_background(image::premultiplied(views[i].rgba), white));
    progress.update(static_cast<int64_t>(i) + 1, {{"psnr", sum / static_cast<double>(i + 1)}});
    progress.check();
  }
  progress.end();
  return views.empty() ? 0 : sum / static_cast<double>(views.size());
}

}  // namespace tt3d::capture
