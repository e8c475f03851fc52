#include "tt3d/bake.h"
#include "tt3d/tensor_file.h"

namespace tt3d {

void save_mesh_tensors(const TexturedMesh& mesh, const std::filesystem::path& path) {
  save_tensors(path,
               {{"vertices", mesh.vertices},
                {"faces", mesh.faces},
                {"uvs", mesh.uvs},
                {"uv_faces", mesh.uv_faces},
                {"texture", mesh.texture}},
               {});
}

}  // namespace tt3d
