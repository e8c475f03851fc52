#pragma once

#include <ATen/core/Tensor.h>

#include "tt3d/appearance.h"
#include "tt3d/surface.h"

namespace tt3d::attack {

/// A round sticker: a connected set of faces [F] (bool, on the device of the mesh) with the share
/// `area` (0 to 1) of the surface. It grows from the outermost face in the direction (azimuth,
/// elevation), in degrees as for views. It does not leave its component of the mesh.
[[nodiscard]] at::Tensor sticker_faces(const scene::TriMesh& mesh, double area, double azimuth_deg,
                                       double elevation_deg);

/// The faces whose centre is light in a mask, [F] bool. mask [H,W,4] uint8 covers the map like a
/// texture. A texel is light if its alpha and its mean of red, green and blue are at least 128.
[[nodiscard]] at::Tensor masked_faces(const scene::UvMap& map, const at::Tensor& mask);

}  // namespace tt3d::attack
