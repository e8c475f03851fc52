#include <ATen/ATen.h>

#include "tt3d/asset.h"
#include "tt3d/surface.h"

namespace tt3d::asset {

void write_ply(const scene::TriMesh& mesh, const std::filesystem::path& path,
               const std::array<double, 3>& origin) {
  at::Tensor vertices = mesh.vertices.cpu().contiguous();
  std::string type = "float";
  if (origin != std::array{0.0, 0.0, 0.0}) {
    type = "double";
    vertices = vertices + at::tensor({origin[0], origin[1], origin[2]}, at::kDouble);
  }
  std::string bytes =
      "ply\nformat binary_little_endian 1.0\nelement vertex " + std::to_string(vertices.size(0)) +
      "\nproperty " + type + " x\nproperty " + type + " y\nproperty " + type + " z\nelement face " +
      std::to_string(mesh.faces.size(0)) + "\nproperty list uchar int vertex_indices\nend_header\n";
  bytes.append(static_cast<const char*>(vertices.const_data_ptr()), vertices.nbytes());
  const at::Tensor faces = mesh.faces.cpu().contiguous();
  const auto* f = static_cast<const char*>(faces.const_data_ptr());
  constexpr size_t kFaceBytes = 3 * sizeof(int32_t);
  for (int64_t i = 0; i < faces.size(0); ++i) {
    bytes.push_back(3);
    bytes.append(f + static_cast<size_t>(i) * kFaceBytes, kFaceBytes);
  }
  write_file_atomic(path, bytes);
}

}  // namespace tt3d::asset
