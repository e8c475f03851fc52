#pragma once

#include <cstdint>

#include "antialias_math.h"
#include "interpolate_math.h"
#include "texture_math.h"

/// Executors of the raster bodies, one for the CPU and one for the GPU: plain pointers in, plain
/// pointers out. Gradients add to zeroed buffers. On the CPU every result has the same bytes with
/// any number of threads; on the GPU sums come in any order.
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

#define TT3D_DECLARE(EXECUTOR)                                                                 \
  template <typename T>                                                                        \
  void rasterize_backward(const EXECUTOR& on, const RasterizeBackwardPixel<T>& body);          \
  template <typename T>                                                                        \
  void interpolate(const EXECUTOR& on, const InterpolatePixel<T>& body);                       \
  template <typename T>                                                                        \
  void interpolate_backward(const EXECUTOR& on, const InterpolateBackwardRast<T>& body);       \
  template <typename T>                                                                        \
  void interpolate_backward(const EXECUTOR& on, const InterpolateBackwardAttributes<T>& body); \
  template <typename T>                                                                        \
  void attribute_derivatives(const EXECUTOR& on, const AttributeDerivativesPixel<T>& body);    \
  template <typename T>                                                                        \
  void antialias(const EXECUTOR& on, const AntialiasPixel<T>& body);                           \
  template <typename T>                                                                        \
  void antialias_backward(const EXECUTOR& on, const AntialiasBackwardPixel<T>& body);          \
  template <typename T>                                                                        \
  void texture(const EXECUTOR& on, const TexturePixel<T>& body);                               \
  template <typename T>                                                                        \
  void texture_backward(const EXECUTOR& on, const TextureBackwardPixel<T>& body);
TT3D_DECLARE(Cpu)
TT3D_DECLARE(Cuda)
#undef TT3D_DECLARE

}  // namespace tt3d::raster
