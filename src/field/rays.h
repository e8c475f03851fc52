#pragma once

#include <ATen/core/Tensor.h>

#include <vector>

#include "tt3d/field.h"

namespace tt3d::field {

/// Rays through pixels: origins and unit directions [R,3], and the pixels' targets [R,4]
/// (premultiplied colour and alpha) when asked for.
struct Rays {
  at::Tensor origins, directions, targets;
};

/// Pixels worth a ray: those whose rays can meet the visual hull. The others see the background in
/// any field that fits the masks, and give no gradient. All on the device of the training.
struct PixelPool {
  at::Tensor pictures;    ///< [all pixels,4] the views' premultiplied colour and alpha, one after
                          ///< the other
  at::Tensor cameras;     ///< [views,kCameraNumbers] double (rays_math.h)
  at::Tensor pixels;      ///< [pool] int64, row-major numbers inside their picture
  at::Tensor view_begin;  ///< [views + 1] int64 into pixels
};
PixelPool make_pixel_pool(const std::vector<View>& views, int64_t occupancy_size,
                          at::Device device);

/// Draws `count` random pixels of the pool, keyed by (seed, step).
Rays random_rays(const PixelPool& pool, int64_t count, uint64_t seed, int64_t step);

/// All pixels of rows [row_begin,row_end) of a camera.
Rays row_rays(const Camera& camera, int64_t row_begin, int64_t row_end, at::Device device);

/// Colour and alpha of rays: [R,4], premultiplied. With gradient when grad mode is on.
/// `specular_loss`, when given, receives the mean square of the specular part; `cost` the samples
/// that were shaded, plus a sixth of those whose density alone was asked.
at::Tensor render_rays(const RadianceField& f, const Rays& rays, const at::Tensor& jitter,
                       double step, bool with_specular, at::Tensor* specular_loss, int64_t* cost);

/// Cells of the occupancy grid that are inside every view's silhouette (where visible at all):
/// the visual hull, dilated by a cell. A cell that no camera sees is empty.
/// Returns [G,G,G] uint8 over (z,y,x).
at::Tensor visual_hull(const std::vector<View>& views, int64_t size);

/// Refreshes the occupancy: density at a jittered point of every hull cell, max(0.95 old, new),
/// occupied above min(mean, 10) (Mueller et al. 2022, appendix E.2).
struct OccupancyGrid {
  at::Tensor hull;     ///< [G,G,G] uint8
  at::Tensor density;  ///< [G,G,G] float
  void refresh(RadianceField& f, uint64_t seed, int64_t step);
};

}  // namespace tt3d::field
