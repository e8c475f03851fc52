#pragma once

#include <ATen/core/Tensor.h>
#include <c10/core/Device.h>

/// The surface of an object: its triangles and their texture coordinates.
namespace tt3d::scene {

/// A triangle mesh. Faces are counter-clockwise when seen from outside.
struct TriMesh {
  at::Tensor vertices;  ///< [V,3] float32
  at::Tensor faces;     ///< [F,3] int32 into vertices
  /// A copy on a device, without gradient; shares memory if it is already there.
  [[nodiscard]] TriMesh to(at::Device device) const;
};

/// Texture coordinates of the triangles of a mesh. (0,0) is the top-left corner of row 0 of the
/// texture, (1,1) the bottom-right corner of its last row; outside [0,1] the texture repeats.
struct UvMap {
  at::Tensor uvs;    ///< [T,2] float32
  at::Tensor faces;  ///< [F,3] int32 into uvs, in the order of the mesh's faces
  /// A copy on a device; shares memory if it is already there.
  [[nodiscard]] UvMap to(at::Device device) const;
};

/// Unit normals of the vertices [V,3]: the mean of the normals of the adjacent faces, weighted by
/// area; 0 for a vertex without faces. faces [F,3]. Differentiable.
[[nodiscard]] at::Tensor vertex_normals(const at::Tensor& vertices, const at::Tensor& faces);

}  // namespace tt3d::scene
