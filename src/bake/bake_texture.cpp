#include <ATen/ATen.h>

#include <vector>

#include "tt3d/bake.h"
#include "tt3d/capture.h"

namespace tt3d {
namespace {

using at::Tensor;

/// The atlas as a picture: which triangle covers each texel. [1,H,W,4].
Tensor rasterize_atlas(const Atlas& atlas) {
  const Tensor u = atlas.uvs.select(1, 0), v = atlas.uvs.select(1, 1);
  const Tensor clip =
      at::stack({u * 2 - 1, 1 - v * 2, at::zeros_like(u), at::ones_like(u)}, 1).unsqueeze(0);
  return rasterize(clip, atlas.uv_faces, atlas.height, atlas.width);
}

/// Gives every texel that no chart covers the colour of the nearest covered one (by steps):
/// a breadth-first walk outward from the charts.
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

Tensor bake_texture(const Atlas& atlas, const Tensor& rest, const Tensor& faces,
                    const SurfaceShader& colors) {
  at::NoGradGuard guard;
  const Tensor rast = rasterize_atlas(atlas);
  const Tensor covered = (rast.select(3, 3) > 0).flatten();
  const Tensor texels = covered.nonzero().flatten();
  // The atlas and the mesh number the same triangles in the same order.
  const SurfacePoints all = surface_points(rest, rast, faces, texels);
  Tensor texture = at::full({atlas.height * static_cast<int64_t>(atlas.width), 3}, 128, at::kByte);
  constexpr int64_t kChunk = 1 << 18;
  for (int64_t i = 0; i < texels.size(0); i += kChunk) {
    const int64_t n = std::min(kChunk, texels.size(0) - i);
    const SurfacePoints points = {all.positions.narrow(0, i, n), all.rast.narrow(0, i, n)};
    texture.index_copy_(0, texels.narrow(0, i, n), to_uint8(colors(points).t().contiguous()));
  }
  Tensor image = texture.view({atlas.height, atlas.width, 3}).contiguous();
  fill_outside(image, covered.to(at::kByte));
  return image;
}

}  // namespace tt3d
