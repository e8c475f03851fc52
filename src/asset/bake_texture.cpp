#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>

#include <vector>

#include "tt3d/asset.h"
#include "tt3d/image.h"
#include "tt3d/raster.h"
#include "tt3d/surface.h"

namespace tt3d::asset {
namespace {

using at::Tensor;

/// The triangle that covers each texel of the atlas: [1,size,size,4].
Tensor rasterize_atlas(const scene::UvMap& map, int64_t size) {
  const Tensor u = map.uvs.select(1, 0), v = map.uvs.select(1, 1);
  const Tensor clip =
      at::stack({u * 2 - 1, 1 - v * 2, at::zeros_like(u), at::ones_like(u)}, 1).unsqueeze(0);
  return raster::rasterize(clip, map.faces, size, size);
}

/// Fills texels outside all charts with the colour of the nearest covered one (by steps): a
/// breadth-first search that starts at the charts.
void fill_outside(Tensor& texture, const Tensor& covered) {
  const int64_t height = texture.size(0), width = texture.size(1);
  auto* t = texture.mutable_data_ptr<uint8_t>();
  const auto* c = covered.const_data_ptr<uint8_t>();
  std::vector<uint8_t> reached(c, c + height * width);
  std::vector<int64_t> front;
  for (int64_t i = 0; i < height * width; ++i) {
    if (reached[i]) front.push_back(i);
  }
  std::vector<int64_t> next;
  while (!front.empty()) {
    next.clear();
    for (const int64_t i : front) {
      const int64_t x = i % width, y = i / width;
      const auto visit = [&](int64_t j) {
        if (reached[j]) return;
        reached[j] = 1;
        for (int k = 0; k < 3; ++k) t[3 * j + k] = t[3 * i + k];
        next.push_back(j);
      };
      if (x > 0) visit(i - 1);
      if (x + 1 < width) visit(i + 1);
      if (y > 0) visit(i - width);
      if (y + 1 < height) visit(i + width);
    }
    front.swap(next);
  }
}

}  // namespace

Tensor bake_texture(const scene::UvMap& map, int64_t size, const scene::TriMesh& rest,
                    const raster::SurfaceShader& colors) {
  at::NoGradGuard guard;
  const Tensor rast = rasterize_atlas(map, size);
  const Tensor covered = (rast.select(3, 3) > 0).flatten();
  const Tensor texels = covered.nonzero().flatten();
  // The atlas and the mesh have the same triangles in the same order.
  const raster::SurfacePoints all = raster::surface_points(rest.vertices, rast, rest.faces, texels);
  Tensor texture = at::full({size * size, 3}, 128, at::kByte);
  constexpr int64_t kChunk = 1 << 18;
  for (int64_t i = 0; i < texels.size(0); i += kChunk) {
    const int64_t n = std::min(kChunk, texels.size(0) - i);
    const raster::SurfacePoints points = {all.positions.narrow(0, i, n), all.rast.narrow(0, i, n)};
    texture.index_copy_(0, texels.narrow(0, i, n),
                        image::to_uint8(colors(points).t().contiguous()));
  }
  Tensor image = texture.view({size, size, 3}).contiguous();
  fill_outside(image, covered.to(at::kByte));
  return image;
}

}  // namespace tt3d::asset
