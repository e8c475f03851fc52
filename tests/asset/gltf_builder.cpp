#include "asset/gltf_builder.h"

#include "tt3d/image.h"

namespace tt3d::testing {

using nlohmann::json;

GltfBuilder::GltfBuilder() {
  root["asset"]["version"] = "2.0";
  root["accessors"] = json::array();
  root["bufferViews"] = json::array();
  root["scenes"] = {{{"nodes", {0}}}};
  root["nodes"] = {{{"mesh", 0}}};
  root["materials"] = {{{"name", "skin"}}};
  json item = {{"material", 0}};
  item["attributes"]["POSITION"] =
      accessor<float>({0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0}, 5126, "VEC3");
  item["attributes"]["TEXCOORD_0"] = accessor<float>({0, 1, 1, 1, 1, 0, 0, 0}, 5126, "VEC2");
  item["indices"] = accessor<uint16_t>({0, 1, 2, 0, 2, 3}, 5123, "SCALAR");
  root["meshes"] = {{{"primitives", {item}}}};
  root["images"] = {
      {{"bufferView", view(image::encode_png(four_colours()))}, {"mimeType", "image/png"}}};
  root["textures"] = {{{"source", 0}}};
}

size_t GltfBuilder::view(const std::string& bytes) {
  binary.resize((binary.size() + 3) / 4 * 4, '\0');
  root["bufferViews"].push_back(
      {{"buffer", 0}, {"byteOffset", binary.size()}, {"byteLength", bytes.size()}});
  binary += bytes;
  return root["bufferViews"].size() - 1;
}

void GltfBuilder::use_texture() {
  material()["pbrMetallicRoughness"]["baseColorTexture"]["index"] = 0;
}

void GltfBuilder::save(const std::filesystem::path& path) {
  root["buffers"] = {{{"byteLength", binary.size()}}};
  write_file_atomic(path, make_glb(root, binary));
}

size_t width_of(const std::string& type) {
  if (type == "SCALAR") return 1;
  return type == "MAT4" ? 16 : static_cast<size_t>(type.back() - '0');
}

}  // namespace tt3d::testing
