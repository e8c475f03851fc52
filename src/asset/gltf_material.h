#pragma once

#include "gltf_file.h"

/// What the materials of a glTF file show.
namespace tt3d::asset {

/// The texture and the factor of a material's colour.
struct GltfMaterial {
  std::string name;
  at::Tensor image;                       ///< [H,W,3] uint8 sRGB; undefined: no texture
  std::array<double, 3> factor{1, 1, 1};  ///< linear light
  Wrap wrap_u = Wrap::kRepeat, wrap_v = Wrap::kRepeat;
  std::string uv_set = "TEXCOORD_0";
  /// uv' = transform * (u, v, 1), row-major 2x3 (KHR_texture_transform).
  std::array<double, 6> transform{1, 0, 0, 0, 1, 0};
  bool emission = false;  ///< the colour is the emission, which vertex colours do not multiply
};

/// Reads materials when they are used.
class GltfMaterials {
 public:
  /// `notes` receives lines for the user.
  GltfMaterials(const GltfFile& file, std::set<std::string>& notes) : file_(file), notes_(notes) {}

  /// Material `index` of the file, or the default material.
  [[nodiscard]] const GltfMaterial& get(std::optional<size_t> index);
  /// The same multiplied by a colour in linear light, for the merged mesh.
  [[nodiscard]] SourceMaterial source(const GltfMaterial& material,
                                      const std::array<float, 3>& colour);

 private:
  [[nodiscard]] GltfMaterial read(size_t index);
  void read_texture(const nlohmann::json& info, GltfMaterial& result);
  [[nodiscard]] at::Tensor read_image(size_t index);
  [[nodiscard]] GltfMaterial base_colour(const nlohmann::json& material);
  [[nodiscard]] GltfMaterial emitted(const nlohmann::json& material);

  const GltfFile& file_;
  std::set<std::string>& notes_;
  std::map<std::optional<size_t>, GltfMaterial> materials_;
  std::map<size_t, at::Tensor> images_;
  Pictures pictures_;
};

}  // namespace tt3d::asset
