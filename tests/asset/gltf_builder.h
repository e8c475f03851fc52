#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "asset/asset_fixtures.h"

namespace tt3d::testing {

/// Component types of an accessor.
constexpr int kFloat = 5126, kByte = 5121, kSignedByte = 5120, kShort = 5123, kSignedShort = 5122;

/// Makes small GLB files. It starts with a unit square in glTF's x-y plane (the x-z plane of the
/// world) and a texture of four_colours that no material uses yet.
class GltfBuilder {
 public:
  GltfBuilder();

  /// Appends data as a buffer view; returns its index.
  size_t view(const std::string& bytes);
  /// Appends an accessor, such as accessor<float>({0, 1, 2}, 5126, "VEC3").
  template <typename T>
  size_t accessor(const std::vector<T>& values, int component_type, const std::string& type,
                  bool normalized = false);
  /// The only primitive, node and material.
  nlohmann::json& primitive() { return root["meshes"][0]["primitives"][0]; }
  nlohmann::json& node() { return root["nodes"][0]; }
  nlohmann::json& material() { return root["materials"][0]; }
  /// Makes the picture the base colour texture.
  void use_texture();

  void save(const std::filesystem::path& path);

  nlohmann::json root;
  std::string binary;
};

/// The number of components of an accessor's type.
[[nodiscard]] size_t width_of(const std::string& type);

template <typename T>
size_t GltfBuilder::accessor(const std::vector<T>& values, int component_type,
                             const std::string& type, bool normalized) {
  const size_t index =
      view(std::string(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T)));
  root["accessors"].push_back({{"bufferView", index},
                               {"componentType", component_type},
                               {"normalized", normalized},
                               {"count", values.size() / width_of(type)},
                               {"type", type}});
  return root["accessors"].size() - 1;
}

}  // namespace tt3d::testing
