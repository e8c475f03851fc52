#pragma once

#include <ATen/core/Tensor.h>

#include "tt3d/appearance.h"

namespace tt3d {

/// A round sticker: faces [F] (bool, on the mesh's device) that make up `area` of the surface (0 to
/// 1), connected, nearest to the face furthest out towards (azimuth, elevation). Angles as those of
/// views. On a mesh of several components it ends with the one that it sits on.
[[nodiscard]] at::Tensor sticker_faces(const TriMesh& mesh, double area, double azimuth_deg,
                                       double elevation_deg);

/// The faces whose middle a drawn mask shows light, [F] bool: mask [H,W,4] uint8 lies over the map
/// as a texture does; light is a mean of red, green and blue of at least 128, and opaque.
[[nodiscard]] at::Tensor masked_faces(const TextureMap& map, const at::Tensor& mask);

}  // namespace tt3d
