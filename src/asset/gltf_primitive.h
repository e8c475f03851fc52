#pragma once

#include "gltf_file.h"
#include "gltf_matrix.h"

/// One primitive of a glTF mesh.
namespace tt3d::asset {

class GltfPrimitive {
 public:
  /// `weights`: of the morph targets. Throws InputError.
  GltfPrimitive(const GltfFile& file, const nlohmann::json& primitive,
                const std::vector<double>& weights);

  [[nodiscard]] bool has(const std::string& attribute) const;
  /// Corner triples; empty for points and lines.
  [[nodiscard]] std::vector<std::array<size_t, 3>> triangles() const;
  [[nodiscard]] std::optional<size_t> material() const;

  [[nodiscard]] std::vector<Vector> positions() const;
  /// The matrix that the joints give to each vertex, or InputError without JOINTS_0 and WEIGHTS_0.
  [[nodiscard]] std::vector<Matrix> skin(const std::vector<Matrix>& joints) const;
  /// Linear, in [0,1]; empty without COLOR_0.
  [[nodiscard]] std::vector<std::array<float, 3>> colours() const;
  /// The coordinates of a set such as TEXCOORD_0.
  [[nodiscard]] std::vector<std::array<double, 2>> uvs(const std::string& set) const;

 private:
  void check_compression() const;
  [[nodiscard]] AccessorValues attribute(const std::string& name,
                                         const std::set<std::string>& types) const;
  [[nodiscard]] std::vector<size_t> corners() const;

  const GltfFile& file_;
  const nlohmann::json& primitive_;
  const nlohmann::json& attributes_;
  const std::vector<double>& weights_;
  size_t count_ = 0;  ///< of vertices
};

/// The weights of a node's morph targets: the node's, else the mesh's.
[[nodiscard]] std::vector<double> morph_weights(const GltfFile& file, const nlohmann::json& node,
                                                const nlohmann::json& mesh);

}  // namespace tt3d::asset
