#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <functional>
#include <utility>

/// Differentiable rasterisation in four operators: rasterize, interpolate, texture, antialias. The
/// split follows Laine et al., "Modular Primitives for High-Performance Differentiable Rendering",
/// TOG 2020; the code is our own.
///
/// Shapes: N views, V vertices, F faces, C channels. All tensors are dense. Values are float32 (or
/// float64, for checks), indices int32. Row 0 is the top of the picture. Errors: a wrong shape or
/// dtype throws c10::Error (a programming error, not a user's).
namespace tt3d::raster {

/// Finds the nearest triangle at every pixel centre.
/// clip [N,V,4] OpenGL clip space; faces [F,3].
/// Returns [N,H,W,4] = (u, v, z/w, triangle + 1), background 0; u and v are the
/// perspective-correct barycentric weights of the triangle's first and second vertex
/// (Olano & Greer, "Triangle scan conversion using 2D homogeneous coordinates", 1997).
/// Both orientations are drawn. Coverage is exact: a pixel centre on a shared edge or vertex
/// belongs to exactly one of the triangles around it. Equal depths go to the lower index.
/// Differentiable: (u, v) with respect to clip; z/w and the index are constants.
[[nodiscard]] at::Tensor rasterize(const at::Tensor& clip, const at::Tensor& faces, int64_t height,
                                   int64_t width);

/// Attributes of the visible surface points: attributes [V,C], rast from rasterize, faces [F,3].
/// Returns [N,H,W,C], 0 on the background. Differentiable with respect to attributes and rast.
[[nodiscard]] at::Tensor interpolate(const at::Tensor& attributes, const at::Tensor& rast,
                                     const at::Tensor& faces);

/// Points of a surface, the input of a SurfaceShader.
struct SurfacePoints {
  at::Tensor positions;  ///< [P,3] position of each point
  at::Tensor rast;       ///< [P,4] rows of rasterize: the triangle and the barycentric weights
};
/// Colours of surface points: [C,P] in [0,1].
using SurfaceShader = std::function<at::Tensor(const SurfacePoints& points)>;

/// The surface points at chosen pixels of `rast`: vertices [V,3] and faces [F,3] of the surface;
/// pixels [P] int64, flat indices of covered pixels. Differentiable as interpolate is.
[[nodiscard]] SurfacePoints surface_points(const at::Tensor& vertices, const at::Tensor& rast,
                                           const at::Tensor& faces, const at::Tensor& pixels);

/// Writes colours into an empty picture: colors [C,P], C at least 3; pixels [P] int64, flat indices
/// of covered pixels, each once, all below `size`, the number of pixels of all views. Returns
/// [size, C + 1]: the first three rows of colors, then alpha, then the other rows; 0 at every other
/// pixel. Differentiable with respect to colors.
[[nodiscard]] at::Tensor paint_pixels(const at::Tensor& colors, const at::Tensor& pixels,
                                      int64_t size);

/// Screen-space derivatives of an interpolated attribute, for mipmap levels: clip is the tensor
/// given to rasterize. Returns [N,H,W,2C] with (d/dx, d/dy) per channel, in units per pixel (y
/// down). Not differentiable.
[[nodiscard]] at::Tensor attribute_derivatives(const at::Tensor& attributes, const at::Tensor& rast,
                                               const at::Tensor& clip, const at::Tensor& faces);

/// For edge e of each face (opposite its vertex e): the same edge in the neighbouring face, as 3 *
/// face + edge, or -1 if the edge has no neighbouring face or more than one. Returns [F,3] int32.
[[nodiscard]] at::Tensor edge_twins(const at::Tensor& faces);

/// Antialiases silhouettes. This gives coverage a gradient with respect to vertex positions. If two
/// neighbouring pixels show different triangles and a silhouette edge of the nearer one passes
/// between their centres, the pixel cut by the edge is blended with its neighbour. The weight is
/// the fraction of the pixel that the edge uncovers (Laine et al. 2020, section 3.5). color
/// [N,H,W,C]; twins from edge_twins. Returns [N,H,W,C]. Differentiable with respect to color and
/// clip. Call it on premultiplied colour with alpha, and composite after.
[[nodiscard]] at::Tensor antialias(const at::Tensor& color, const at::Tensor& rast,
                                   const at::Tensor& clip, const at::Tensor& faces,
                                   const at::Tensor& twins);

/// Texture look-up, bilinear within a mipmap level, linear between levels, wrapped at the borders.
/// texture [H,W,C]; uv [N,h,w,2] in [0,1], (0,0) is the outer corner of texel (0,0); uv_derivatives
/// [N,h,w,4] from attribute_derivatives, or undefined for no mipmaps; rast is the mask: its
/// background pixels return 0. Returns [N,h,w,C]. Differentiable with respect to texture and uv;
/// the mipmap level is a constant.
[[nodiscard]] at::Tensor texture(const at::Tensor& texture, const at::Tensor& uv,
                                 const at::Tensor& uv_derivatives, const at::Tensor& rast);

}  // namespace tt3d::raster
