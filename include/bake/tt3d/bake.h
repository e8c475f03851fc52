#pragma once

#include <ATen/core/Tensor.h>

#include <filesystem>

#include "tt3d/core.h"
#include "tt3d/raster.h"

/// Textured meshes as files. World right-handed, +Z up, in the input's coordinates and units.
namespace tt3d {

/// A mesh with one texture.
struct TexturedMesh {
  at::Tensor vertices;  ///< [V,3] float32, world
  at::Tensor faces;     ///< [F,3] int32, counter-clockwise seen from the front
  at::Tensor uvs;       ///< [T,2] float32; (0,0) is the top-left corner of the texture's row 0,
                        ///< (1,1) the bottom-right corner of its last row
  at::Tensor uv_faces;  ///< [F,3] int32 into uvs
  at::Tensor texture;   ///< [H,W,3] uint8, sRGB, row 0 at the top
};

/// Refuses meshes that are empty, have the wrong shapes or types, values that are not finite or
/// indices out of range: InputError starting with `where`.
void check_mesh(const TexturedMesh& mesh, const std::filesystem::path& where);

/// Hands a mesh to the tools in Python: safetensors of its tensors under their names here. Throws
/// ResourceError.
void save_mesh_tensors(const TexturedMesh& mesh, const std::filesystem::path& path);

/// Writes a self-contained binary glTF 2.0: one mesh, PNG texture, KHR_materials_unlit with a
/// matte lit fallback. glTF is Y-up: (x, y, z) is written as (x, z, -y). Vertices are split where
/// uvs differ, as glTF has one index for both. Throws InputError (see check_mesh) and
/// ResourceError.
void write_glb(const TexturedMesh& mesh, const std::filesystem::path& path);

/// Writes NAME.obj with NAME.mtl and NAME.png beside it, coordinates as they are (+Z up), indices
/// of positions and uvs kept apart. Throws InputError (see check_mesh) and ResourceError.
void write_obj(const TexturedMesh& mesh, const std::filesystem::path& path);

/// Reads a .glb (Y-up, turned to +Z up) or an .obj (taken as +Z up), ours or another tool's.
/// Several meshes, nodes and materials become one mesh and one texture; textures that repeat are
/// tiled; materials without a texture get one from their colour or vertex colours. Light, normals,
/// animation and transparency are ignored. uvs come back in [0,1]. Throws InputError naming the
/// file and what is wrong with it.
[[nodiscard]] TexturedMesh load_asset(const std::filesystem::path& path);

/// Where the surface lies in a texture.
struct Atlas {
  at::Tensor uvs;             ///< [T,2] float32 in [0,1], as in TexturedMesh
  at::Tensor uv_faces;        ///< [F,3] int32 into uvs
  int width = 0, height = 0;  ///< texels
};

/// Cuts the surface into charts without overlap and packs them into a square atlas of
/// `resolution` texels with about `padding` texels between charts (xatlas, in a child process).
/// `vertices` [V,3] float32, `faces` [F,3] int32. The Python interpreter is $TT3D_PYTHON, else
/// that of the source tree's .venv, else python3. Throws InputError for a malformed mesh,
/// MissingToolError without xatlas, ResourceError at the time limit or when xatlas fails.
[[nodiscard]] Atlas unwrap(const at::Tensor& vertices, const at::Tensor& faces, int resolution,
                           int padding, double time_limit_seconds);

/// Samples a colour function (sRGB) at every texel that the surface covers: `rest` [V,3] are the
/// positions the function knows, `faces` [F,3] their triangles. Texels outside the charts take the
/// colour of the nearest one inside, so that mipmaps do not bleed. Returns [H,W,3] uint8.
[[nodiscard]] at::Tensor bake_texture(const Atlas& atlas, const at::Tensor& rest,
                                      const at::Tensor& faces, const SurfaceShader& colors);

}  // namespace tt3d
