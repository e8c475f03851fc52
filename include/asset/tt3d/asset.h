#pragma once

#include <ATen/core/Tensor.h>

#include <array>
#include <filesystem>
#include <map>
#include <optional>
#include <vector>

#include "tt3d/core.h"
#include "tt3d/keys.h"
#include "tt3d/raster.h"
#include "tt3d/scene.h"
#include "tt3d/surface.h"

/// Textured meshes as files. World right-handed, +Z up, in the coordinates and units of the input.
/// Far from the world's origin float32 would lose digits; there the vertices are relative to
/// TexturedMesh::origin, and so are all cameras and frames made for the mesh.
namespace tt3d::asset {

/// A mesh with one texture.
struct TexturedMesh {
  at::Tensor vertices;                    ///< [V,3] float32, world minus origin
  at::Tensor faces;                       ///< [F,3] int32, counter-clockwise seen from the front
  scene::UvMap map;                       ///< texture coordinates of the faces
  at::Tensor texture;                     ///< [H,W,3] uint8, sRGB, row 0 at the top
  std::array<double, 3> origin{0, 0, 0};  ///< see far_origin
  /// The files that load_asset read: the asset, its material files, buffers and pictures.
  std::vector<std::filesystem::path> files = {};
};

/// The origin for a mesh in the box from `low` to `high`: zero for most, and a point near the
/// centre if the coordinates are over 256 times as large as the box.
[[nodiscard]] std::array<double, 3> far_origin(const std::array<double, 3>& low,
                                               const std::array<double, 3>& high);

/// Throws InputError that begins with `where` if a mesh is empty, has tensors of the wrong shape or
/// dtype, values that are not finite, or indices out of range.
void check_mesh(const TexturedMesh& mesh, const std::filesystem::path& where);

/// Writes a mesh for the Python tools: a safetensors file of its tensors, named as the members. The
/// vertices stay relative to the origin. Throws ResourceError.
void save_mesh_tensors(const TexturedMesh& mesh, const std::filesystem::path& path);

/// Writes a self-contained binary glTF 2.0: one mesh, a PNG texture, KHR_materials_unlit, and a
/// matte lit material as fallback. glTF is Y-up: (x, y, z) is written as (x, z, -y). glTF has one
/// index for position and uv, so a vertex with several uvs is split. An origin becomes the node's
/// translation. Throws InputError (see check_mesh) and ResourceError.
void write_glb(const TexturedMesh& mesh, const std::filesystem::path& path);

/// Writes NAME.obj with NAME.mtl and NAME.png beside it. Coordinates stay unchanged (+Z up);
/// positions and uvs have separate indices. Throws InputError (see check_mesh) and ResourceError.
void write_obj(const TexturedMesh& mesh, const std::filesystem::path& path);

/// Writes a binary PLY with vertices and faces only; the vertices are relative to `origin`, which
/// is added (as float64 unless it is zero). Throws ResourceError.
void write_ply(const scene::TriMesh& mesh, const std::filesystem::path& path,
               const std::array<double, 3>& origin = {0, 0, 0});

/// Reads a .glb or .gltf (Y-up, rotated to +Z up) or an .obj (assumed +Z up), written by tt3d or
/// another program. Several meshes, nodes and materials become one mesh and one texture. Repeating
/// textures are tiled. A material without a texture gets one from its colour or the vertex colours.
/// Light, normals, animation and transparency are ignored. The uvs are in [0,1]. `progress`
/// receives notes on what was ignored or replaced. Throws InputError with the file and the problem.
[[nodiscard]] TexturedMesh load_asset(const std::filesystem::path& path,
                                      Progress* progress = nullptr);

/// Asset files; each is loaded once.
class AssetFiles {
 public:
  /// load_asset(path, progress), or the earlier result for this path. All assets have the origin of
  /// the first, so that they can be compared.
  [[nodiscard]] const TexturedMesh& load(const std::filesystem::path& path,
                                         Progress* progress = nullptr);
  /// Forgets a file, because it is written again.
  void forget(const std::filesystem::path& path) { loaded_.erase(path); }

 private:
  std::map<std::filesystem::path, TexturedMesh> loaded_;
  std::optional<std::array<double, 3>> origin_;
};

/// The frame of the views of an asset, in its units: read from `views.json` beside it (a run writes
/// this file from its capture), else derived from the bounding box of the asset. Its centre is
/// relative to the asset's origin. Throws InputError.
[[nodiscard]] scene::ViewFrame view_frame(const TexturedMesh& asset,
                                          const std::filesystem::path& asset_path);
/// Writes `views.json` into the folder of the assets.
void write_view_frame(const scene::ViewFrame& frame, const std::filesystem::path& folder);

/// Options of the stage that makes an object a textured asset.
struct BakeOptions {
  int resolution = 2048;
  int padding = 4;
  double unwrap_time_limit = 300;

  void keys(KeyList& key) {
    key("resolution", resolution, {64, 16384}, "texels", "side of the texture");
    key("padding", padding, {0, 64}, "texels", "space between charts");
    key("unwrap_time_limit", unwrap_time_limit, {1, 1e5}, "seconds", "time limit of the unwrap");
  }
};

/// Cuts the surface into charts without overlap and packs them into a square atlas of `resolution`
/// texels with about `padding` texels between charts (xatlas, in a child process). `vertices` [V,3]
/// float32, `faces` [F,3] int32. The Python interpreter is $TT3D_PYTHON, else that of .venv in the
/// source tree, else python3. Throws InputError for a malformed mesh, MissingToolError without
/// xatlas, ResourceError at the time limit or if xatlas fails.
[[nodiscard]] scene::UvMap unwrap(const at::Tensor& vertices, const at::Tensor& faces,
                                  int resolution, int padding, double time_limit_seconds);

/// Samples a colour function (sRGB) at every texel of a square texture that the surface covers. The
/// function gets points of the surface `rest`, whose faces have the order of the map's faces.
/// Texels outside the charts get the colour of the nearest texel inside, so that mipmaps do not
/// bleed. Returns [size,size,3] uint8.
[[nodiscard]] at::Tensor bake_texture(const scene::UvMap& map, int64_t size,
                                      const scene::TriMesh& rest,
                                      const raster::SurfaceShader& colors);

}  // namespace tt3d::asset
