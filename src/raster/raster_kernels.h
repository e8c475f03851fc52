#pragma once

#include <cstdint>

#include "antialias_math.h"
#include "interpolate_math.h"
#include "paint_math.h"
#include "texture_math.h"

/// Loops over the raster bodies that need more than for_each_index. Inputs and outputs are plain
/// pointers. Gradients are added to zeroed buffers. On the CPU every result has the same bytes with
/// any number of threads.
namespace tt3d::raster {

template <typename T>
void rasterize(const Cpu&, const T* clip, const int32_t* faces, T* rast, const Sizes& s);

/// Working memory of rasterize on the GPU; the caller owns it.
struct DepthBuffer {
  uint64_t* depth;  ///< [N,H,W] starts with all bits set; least depth so far, as an ordered integer
  uint32_t* face;   ///< [N,H,W] starts with all bits set; the lowest triangle at that depth
  int32_t* list;    ///< [N * F] triangles large enough to be split between threads
  int64_t* listed;  ///< [2] zeros; number of list entries at the front, and at the back
};
/// Writes every pixel of rast. N * F below 2^31.
template <typename T>
void rasterize(const Cuda& on, const T* clip, const int32_t* faces, const DepthBuffer& buffer,
               T* rast, const Sizes& s);

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

// Bodies whose faces are independent.
template <typename T>
void for_each_face(const Cpu&, const FacingFace<T>& body);

template <typename Body>
void for_each_face(const Cuda& on, const Body& body) {
  for_each_index(on, body.s.views * body.s.faces, body);
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

// Bodies that add to sums shared by several pixels: in pixel order here, in any order on the GPU.
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

template <typename T>
void scatter(const Cuda& on, const RasterizeBackwardPixel<T>& body);
template <typename T>
void scatter(const Cuda& on, const InterpolateBackwardPixel<T>& body);
template <typename Body>
void scatter(const Cuda& on, const Body& body) {
  for_each_index(on, body.s.pixels(), body);
}

}  // namespace tt3d::raster
