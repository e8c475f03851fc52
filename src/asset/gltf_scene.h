#pragma once

#include "gltf_file.h"
#include "gltf_matrix.h"

/// The nodes of a glTF scene at rest: the transforms in the file, without its animations.
namespace tt3d::asset {

struct PlacedNode {
  const nlohmann::json* node = nullptr;
  Matrix world = kIdentity;
};

class GltfScene {
 public:
  /// Throws InputError unless the nodes form a forest.
  explicit GltfScene(const GltfFile& file);

  /// The visible nodes of the default scene; without scenes, all visible nodes.
  [[nodiscard]] const std::vector<PlacedNode>& nodes() const { return nodes_; }
  /// World matrices of the copies of a node's mesh: one, or those of EXT_mesh_gpu_instancing.
  [[nodiscard]] std::vector<Matrix> placements(const PlacedNode& node) const;
  /// The matrices that take vertices of a skinned mesh to the world, one for each joint.
  [[nodiscard]] std::vector<Matrix> joint_matrices(size_t skin) const;

 private:
  [[nodiscard]] std::vector<size_t> root_nodes() const;
  [[nodiscard]] Matrix world_of(size_t node) const;

  const GltfFile& file_;
  std::vector<PlacedNode> nodes_;
  std::map<size_t, Matrix> worlds_;   ///< of nodes_, by number
  std::map<size_t, size_t> parents_;  ///< of all nodes, if there are skins
};

}  // namespace tt3d::asset
