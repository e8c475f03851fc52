#include <ATen/ATen.h>
#include "tt3d/bake.h"
#include "tt3d/core.h"
#include "tt3d/tensor_file.h"
#include "tt3d/tool.h"

namespace tt3d {
namespace fs = std::filesystem;

namespace {

/// Every face must have a place in the atlas.
Atlas read_atlas(const fs::path& path, int64_t face_count, int resolution) {
  const TensorFile file = load_tensors(path);
  Atlas atlas{file.get("uvs", {-1, 2}, at::kFloat), file.get("uv_faces", {face_count, 3}, at::kInt),
              resolution, resolution};
  const bool inside = atlas.uvs.ge(0).logical_and(atlas.uvs.le(1)).all().item<bool>() &&
                      atlas.uv_faces.ge(0).all().item<bool>() &&
                      atlas.uv_faces.lt(atlas.uvs.size(0)).all().item<bool>();
  if (!inside) throw ResourceError("UV unwrapping gave coordinates outside the atlas");
  return atlas;
}

}  // namespace

Atlas unwrap(const at::Tensor& vertices, const at::Tensor& faces, int resolution, int padding,
             double time_limit_seconds) {
  if (resolution < 16 || resolution > 16384 || padding < 0 || padding > resolution / 4) {
    throw InputError(
        "UV atlas: expected a resolution of 16 to 16384 texels and a padding of at "
        "most a quarter of it");
  }
  // The checks of a mesh, with uvs standing in.
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
  return read_atlas(output, faces.size(0), resolution);
}

}  // namespace tt3d
