#include <ATen/ATen.h>

#include <algorithm>

#include "asset_source.h"
#include "tt3d/image.h"

namespace tt3d::asset {
namespace fs = std::filesystem;

namespace {

void check_matrix(const at::Tensor& t, int64_t columns, at::ScalarType type, const char* name,
                  const fs::path& where) {
  if (!t.defined() || t.dim() != 2 || t.size(1) != columns || t.scalar_type() != type ||
      t.size(0) == 0) {
    throw InputError(where, std::string("the mesh's ") + name + " must be a non-empty [N," +
                                std::to_string(columns) + "] " + at::toString(type) + " tensor");
  }
}

void check_finite(const at::Tensor& t, const char* name, const fs::path& where) {
  if (!t.isfinite().all().item<bool>()) {
    throw InputError(where,
                     std::string("the mesh's ") + name + " contain values that are not finite");
  }
}

void check_indices(const at::Tensor& t, int64_t limit, const char* name, const fs::path& where) {
  if (t.min().item<int32_t>() < 0 || t.max().item<int32_t>() >= limit) {
    throw InputError(where, std::string("the mesh's ") + name + " point outside their array of " +
                                std::to_string(limit));
  }
}

}  // namespace

void check_mesh(const TexturedMesh& mesh, const fs::path& where) {
  check_matrix(mesh.vertices, 3, at::kFloat, "vertices", where);
  check_matrix(mesh.faces, 3, at::kInt, "faces", where);
  check_matrix(mesh.map.uvs, 2, at::kFloat, "uvs", where);
  check_matrix(mesh.map.faces, 3, at::kInt, "uv faces", where);
  if (mesh.faces.size(0) != mesh.map.faces.size(0)) {
    throw InputError(where, "the mesh has a different number of faces and uv faces");
  }
  check_finite(mesh.vertices, "vertices", where);
  check_finite(mesh.map.uvs, "uvs", where);
  check_indices(mesh.faces, mesh.vertices.size(0), "faces", where);
  check_indices(mesh.map.faces, mesh.map.uvs.size(0), "uv faces", where);
  const at::Tensor& texture = mesh.texture;
  if (!texture.defined() || texture.dim() != 3 || texture.size(2) != 3 ||
      texture.scalar_type() != at::kByte || texture.numel() == 0) {
    throw InputError(where, "the mesh's texture must be a non-empty [H,W,3] uint8 tensor");
  }
}

TexturedMesh load_asset(const fs::path& path) {
  std::string extension = path.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  if (extension != ".glb" && extension != ".obj") {
    throw InputError(path, "expected an asset with the extension .glb or .obj");
  }
  TexturedMesh mesh = merge_materials(extension == ".glb" ? read_glb(path) : read_obj(path));
  check_mesh(mesh, path);
  return mesh;
}

std::string read_part(const fs::path& path) {
  std::error_code unknown;
  const uintmax_t bytes = fs::file_size(path, unknown);
  if (!unknown && bytes > kMaxPartBytes) {
    throw InputError(path, "has " + std::to_string(bytes >> 20) + " MiB, over the limit of " +
                               std::to_string(kMaxPartBytes >> 20) +
                               "; decimate the mesh or shrink its textures");
  }
  return read_file(path);
}

fs::path resolve_reference(const fs::path& asset, const std::string& reference) {
  std::string name = reference;
  std::replace(name.begin(), name.end(), '\\', '/');
  const fs::path path = fs::path(name).lexically_normal();
  if (path.empty() || path.is_absolute() || *path.begin() == ".." || name.find(':') != name.npos) {
    throw InputError(asset, "refers to '" + reference +
                                "', which leads out of its folder; put "
                                "the file next to the asset and use a relative path");
  }
  fs::path found = asset.parent_path() / path;
  if (!fs::is_regular_file(found))
    throw InputError(found, "no such file, named by " + asset.string());
  return found;
}

at::Tensor rgb_image(std::string_view bytes, const fs::path& name) {
  return image::decode_image(bytes, name).narrow(2, 0, 3).contiguous();
}

}  // namespace tt3d::asset
