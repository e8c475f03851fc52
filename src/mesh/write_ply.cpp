#include <ATen/ATen.h>

#include <cstring>

#include "tt3d/mesh.h"

namespace tt3d {

void write_ply(const TriMesh& mesh, const Normalization& normalization,
               const std::filesystem::path& path) {
  const at::Tensor centre = at::tensor(
      {normalization.centre[0], normalization.centre[1], normalization.centre[2]}, at::kDouble);
  const at::Tensor world = (mesh.vertices.cpu().to(at::kDouble) / normalization.scale + centre)
                               .to(at::kFloat)
                               .contiguous();
  std::string bytes =
      "ply\nformat binary_little_endian 1.0\nelement vertex " + std::to_string(world.size(0)) +
      "\nproperty float x\nproperty float y\nproperty float z\nelement face " +
      std::to_string(mesh.faces.size(0)) + "\nproperty list uchar int vertex_indices\nend_header\n";
  bytes.append(static_cast<const char*>(world.const_data_ptr()), world.nbytes());
  const at::Tensor faces = mesh.faces.cpu().contiguous();
  const auto* f = static_cast<const char*>(faces.const_data_ptr());
  constexpr size_t kFaceBytes = 3 * sizeof(int32_t);
  for (int64_t i = 0; i < faces.size(0); ++i) {
    bytes.push_back(3);
    bytes.append(f + static_cast<size_t>(i) * kFaceBytes, kFaceBytes);
  }
  write_file_atomic(path, bytes);
}

}  // namespace tt3d
