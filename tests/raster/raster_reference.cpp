#include "raster/raster_reference.h"
#include "tt3d/raster.h"

namespace tt3d::testing {
namespace {

at::Tensor pixel_grid(int64_t height, int64_t width) {
  const auto options = at::TensorOptions().dtype(at::kDouble);
  const at::Tensor x = (at::arange(width, options) + 0.5) / double(width) * 2 - 1;
  const at::Tensor y = 1 - (at::arange(height, options) + 0.5) / double(height) * 2;
  return at::stack({x.unsqueeze(0).expand({height, width}), y.unsqueeze(1).expand({height, width})},
                   -1);
}

at::Tensor cross2(const at::Tensor& a, const at::Tensor& b) {
  return a.select(-1, 0) * b.select(-1, 1) - a.select(-1, 1) * b.select(-1, 0);
}

/// Screen-space weights of points p in triangles (a,b,c), then divided by depth and normalised.
at::Tensor corrected_weights(const at::Tensor& p, const at::Tensor& corners) {
  const at::Tensor w = corners.select(-1, 3);                        // [...,3]
  const at::Tensor xy = corners.narrow(-1, 0, 2) / w.unsqueeze(-1);  // [...,3,2]
  const at::Tensor a = xy.select(-2, 0), b = xy.select(-2, 1), c = xy.select(-2, 2);
  const at::Tensor area = cross2(b - a, c - a);
  const at::Tensor screen =
      at::stack({cross2(c - b, p - b), cross2(a - c, p - c), cross2(b - a, p - a)}, -1) /
      area.unsqueeze(-1);
  const at::Tensor over_w = screen / w;
  return at::cat({over_w / over_w.sum(-1, true), screen}, -1);
}

}  // namespace

at::Tensor reference_rasterize(const at::Tensor& clip_in, const at::Tensor& faces, int64_t height,
                               int64_t width) {
  const at::Tensor clip = clip_in.to(at::kDouble);
  const at::Tensor index = faces.to(at::kLong);
  const at::Tensor p = pixel_grid(height, width).unsqueeze(2);  // [H,W,1,2]
  std::vector<at::Tensor> views;
  for (int64_t n = 0; n < clip.size(0); ++n) {
    const at::Tensor corners = clip[n].index({index}).unsqueeze(0).unsqueeze(0);  // [1,1,F,3,4]
    const at::Tensor weights = corrected_weights(p, corners);                     // [H,W,F,6]
    const at::Tensor u = weights.narrow(-1, 0, 3);
    const at::Tensor inside = (weights.narrow(-1, 3, 3) >= 0).all(-1);
    const at::Tensor depth =
        (u * corners.select(-1, 2)).sum(-1) / (u * corners.select(-1, 3)).sum(-1);
    const at::Tensor visible = inside & (depth >= -1) & (depth <= 1);
    const at::Tensor masked = at::where(visible, depth, at::full({}, 1e30, at::kDouble));
    const auto [nearest, face] = masked.min(-1);
    const at::Tensor hit = (nearest < 1e29).to(at::kDouble);
    const at::Tensor uv = u.gather(2, face.unsqueeze(-1).unsqueeze(-1).expand({-1, -1, 1, 3}))
                              .squeeze(2)
                              .narrow(-1, 0, 2);
    views.push_back(at::cat({uv * hit.unsqueeze(-1), (nearest * hit).unsqueeze(-1),
                             ((face + 1).to(at::kDouble) * hit).unsqueeze(-1)},
                            -1));
  }
  return at::stack(views);
}

at::Tensor reference_barycentrics(const at::Tensor& clip, const at::Tensor& rast,
                                  const at::Tensor& faces) {
  const at::Tensor p = pixel_grid(rast.size(1), rast.size(2));
  const at::Tensor face = rast.select(-1, 3).to(at::kLong) - 1;
  const at::Tensor index = faces.to(at::kLong).index({face.clamp_min(0)});  // [N,H,W,3]
  std::vector<at::Tensor> views;
  for (int64_t n = 0; n < clip.size(0); ++n) {
    const at::Tensor weights = corrected_weights(p, clip[n].index({index[n]}));
    views.push_back(weights.narrow(-1, 0, 2) * (face[n] >= 0).to(at::kDouble).unsqueeze(-1));
  }
  return at::stack(views);
}

}  // namespace tt3d::testing
