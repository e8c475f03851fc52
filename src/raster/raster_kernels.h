#pragma once

#include <cstdint>

#include "antialias_math.h"
#include "interpolate_math.h"
#include "texture_math.h"

/// Loops over the raster bodies that need more than for_each_index: plain pointers in, plain
/// pointers out. Gradients add to zeroed buffers. On the CPU every result has the same bytes with
/// any number of threads.
namespace tt3d::raster {

template <typename T>
void rasterize(const Cpu&, const T* clip, const int32_t* faces, T* rast, const Sizes& s);

/// The GPU's rasterize in three launches, the memory between them being the caller's.
/// Tiles are numbered view by view.
int64_t tile_count(const Sizes& s);
/// counts [tiles + 1], zeroed: adds to element t + 1 the triangles that can touch tile t.
template <typename T>
void count_tile_faces(const Cuda& on, const T* clip, const int32_t* faces, int64_t* counts,
                      const Sizes& s);
/// next [tiles]: where each tile's list begins; moved to where it ends. list: the lists.
template <typename T>
void fill_tile_lists(const Cuda& on, const T* clip, const int32_t* faces, int64_t* next,
                     int32_t* list, const Sizes& s);
/// begin [tiles + 1]: where each tile's list begins. Writes every pixel of rast.
template <typename T>
void draw_tiles(const Cuda& on, const T* clip, const int32_t* faces, const int64_t* begin,
                const int32_t* list, T* rast, const Sizes& s);

// Bodies whose pixels are independent.
template <typename T>
void for_each_pixel(const Cpu&, const InterpolatePixel<T>& body);
template <typename T>
void for_each_pixel(const Cpu&, const AttributeDerivativesPixel<T>& body);
template <typename T>
void for_each_pixel(const Cpu&, const TexturePixel<T>& body);

template <typename Body>
void for_each_pixel(const Cuda& on, const Body& body) {
  for_each_index(on, body.s.pixels(), body);
}

// Bodies whose texels are independent.
template <typename T>
void for_each_texel(const Cpu&, const HalveTexel<T>& body);
template <typename T>
void for_each_texel(const Cpu&, const FoldTexel<T>& body);

template <typename Body>
void for_each_texel(const Cuda& on, const Body& body) {
  for_each_index(on, body.count(), body);
}

// Bodies that add to sums which pixels share: in pixel order here, in any order on the GPU.
template <typename T>
void scatter(const Cpu&, const RasterizeBackwardPixel<T>& body);
template <typename T>
void scatter(const Cpu&, const InterpolateBackwardPixel<T>& body);
template <typename T>
void scatter(const Cpu&, const AntialiasPixel<T>& body);
template <typename T>
void scatter(const Cpu&, const AntialiasBackwardPixel<T>& body);
template <typename T>
void scatter(const Cpu&, const TextureBackwardPixel<T>& body);

template <typename Body>
void scatter(const Cuda& on, const Body& body) {
  for_each_index(on, body.s.pixels(), body);
}

}  // namespace tt3d::raster
