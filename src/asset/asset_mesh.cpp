#include <ATen/ATen.h>

#include <algorithm>

#include "asset_source.h"
#include "tt3d/input_files.h"

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

TexturedMesh load_asset(const fs::path& path, Progress* progress) {
  if (!has_extension(path, {".glb", ".gltf", ".obj"})) {
    throw InputError(path, "expected an asset with the extension .glb or .obj or .gltf");
  }
  const AssetSource source = has_extension(path, {".obj"}) ? read_obj(path) : read_gltf(path);
  TexturedMesh mesh = merge_materials(source);
  check_mesh(mesh, path);
  mesh.files.assign(source.files.begin(), source.files.end());
  for (const std::string& line : source.notes) {
    if (progress != nullptr) progress->note(line);
  }
  return mesh;
}

}  // namespace tt3d::asset
