#include <ATen/ATen.h>
#include "tt3d/asset.h"
#include "tt3d/core.h"
#include "tt3d/surface.h"
#include "tt3d/tensor_file.h"
#include "tt3d/tool.h"

namespace tt3d::asset {
namespace fs = std::filesystem;

namespace {

/// Reads the atlas; every face must have coordinates in it.
scene::UvMap read_atlas(const fs::path& path, int64_t face_count) {
  const TensorFile file = load_tensors(path);
  scene::UvMap map{file.get("uvs", {-1, 2}, at::kFloat),
                   file.get("uv_faces", {face_count, 3}, at::kInt)};
  const bool inside = map.uvs.ge(0).logical_and(map.uvs.le(1)).all().item<bool>() &&
                      map.faces.ge(0).all().item<bool>() &&
                      map.faces.lt(map.uvs.size(0)).all().item<bool>();
  if (!inside) throw ResourceError("UV unwrapping returned coordinates outside the atlas");
  return map;
}

}  // namespace

scene::UvMap unwrap(const at::Tensor& vertices, const at::Tensor& faces, int resolution,
                    int padding, double time_limit_seconds) {
  if (resolution < 16 || resolution > 16384 || padding < 0 || padding > resolution / 4) {
    throw InputError(
        "UV atlas: expected a resolution of 16 to 16384 texels and a padding of at "
        "most a quarter of it");
  }
  // The checks of a textured mesh, with placeholders for the uvs.
  check_mesh({vertices, faces,
              vertices.defined() && vertices.dim() == 2
                  ? vertices.narrow(1, 0, std::min<int64_t>(2, vertices.size(1)))
                  : vertices,
              faces, at::zeros({1, 1, 3}, at::kByte)},
             "mesh to unwrap");
  const ExchangeFolder folder;
  const fs::path input = folder / "mesh.safetensors";
  const fs::path output = folder / "atlas.safetensors";
  save_tensors(input, {{"vertices", vertices}, {"faces", faces}}, {});
  Progress silent;
  (void)run_tool(
      "unwrap.py",
      {input.string(), output.string(), std::to_string(resolution), std::to_string(padding)},
      "UV unwrapping", time_limit_seconds, silent);
  return read_atlas(output, faces.size(0));
}

}  // namespace tt3d::asset
