#include "tt3d/asset.h"
#include "tt3d/tensor_file.h"

namespace tt3d::asset {

void save_mesh_tensors(const TexturedMesh& mesh, const std::filesystem::path& path) {
  save_tensors(path,
               {{"vertices", mesh.vertices},
                {"faces", mesh.faces},
                {"uvs", mesh.map.uvs},
                {"uv_faces", mesh.map.faces},
                {"texture", mesh.texture}},
               {});
}

}  // namespace tt3d::asset
