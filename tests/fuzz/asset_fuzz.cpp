// Any bytes as an asset: a mesh that passes its checks, or InputError. The first byte selects the
// format: 'g' is GLB, 'm' is MTL, anything else OBJ.

#include "asset_source.h"
#include "memory_file.h"
#include "mtl_library.h"

namespace {

void read_asset(const std::filesystem::path& path, bool glb) {
  const tt3d::asset::AssetSource source =
      glb ? tt3d::asset::read_gltf(path) : tt3d::asset::read_obj(path);
  const tt3d::asset::TexturedMesh mesh = tt3d::asset::merge_materials(source);
  tt3d::asset::check_mesh(mesh, path);
}

/// Reads a material library and its material "one".
void read_mtl(const std::filesystem::path& path) {
  tt3d::asset::AssetSource source;
  tt3d::asset::MtlLibrary library(path, source);
  library.add(path.filename().string());
  const tt3d::asset::MtlMaterial* material = library.find("one");
  if (material != nullptr) (void)library.load(*material);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size == 0) return 0;
  const tt3d::testing::MemoryFile file(data + 1, size - 1);
  try {
    if (data[0] == 'm') {
      read_mtl(file.path());
    } else {
      read_asset(file.path(), data[0] == 'g');
    }
  } catch (const tt3d::InputError&) {
    return 0;
  }
  return 0;
}
