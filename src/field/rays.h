#pragma once

#include <ATen/core/Tensor.h>

#include <vector>

#include "tt3d/capture.h"
#include "tt3d/field.h"
#include "tt3d/scene.h"

namespace tt3d::field {

/// Rays through pixels: origins and unit directions [R,3], and the pixels' targets [R,4]
/// (premultiplied colour and alpha) if requested.
struct Rays {
  at::Tensor origins, directions, targets;
};

/// The training pixels: those whose rays can hit the visual hull. All other pixels show the
/// background in any field that fits the masks, and give no gradient. The tensors are on the
/// training device.
struct PixelPool {
  at::Tensor pictures;    ///< [all pixels,4] uint8, straight alpha, view after view
  at::Tensor cameras;     ///< [views,kCameraNumbers] double (rays_math.h)
  at::Tensor pixels;      ///< [pool] int32, row-major indices within the picture
  at::Tensor view_begin;  ///< [views + 1] int64 into pixels
};
PixelPool make_pixel_pool(const std::vector<capture::View>& views, int64_t occupancy_size,
                          at::Device device);

/// Draws `count` random pixels of the pool, keyed by (seed, step).
Rays random_rays(const PixelPool& pool, int64_t count, uint64_t seed, int64_t step);

/// All pixels of rows [row_begin,row_end) of a camera.
Rays row_rays(const scene::Camera& camera, int64_t row_begin, int64_t row_end, at::Device device);

/// Colour and alpha of rays: [R,4], premultiplied. With gradient if grad mode is on.
/// `specular_loss`, if given, receives the mean square of the specular part; `cost` receives the
/// number of shaded samples plus a sixth of those that only needed a density.
at::Tensor render_rays(const RadianceField& f, const Rays& rays, const at::Tensor& jitter,
                       double step, bool with_specular, at::Tensor* specular_loss, int64_t* cost);

/// The visual hull, dilated by a cell: the cells of the occupancy grid inside the silhouette of
/// every view that sees them. A cell that no camera sees is empty. Returns [G,G,G] uint8 over
/// (z,y,x).
at::Tensor visual_hull(const std::vector<capture::View>& views, int64_t size);

/// Updates the occupancy: the density at a jittered point of every hull cell; keeps max(0.95 old,
/// new); occupied if above min(mean, 10) (Mueller et al. 2022, appendix E.2).
struct OccupancyGrid {
  at::Tensor hull;     ///< [G,G,G] uint8
  at::Tensor density;  ///< [G,G,G] float
  void refresh(RadianceField& f, uint64_t seed, int64_t step);
};

}  // namespace tt3d::field
