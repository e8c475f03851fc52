#include "gltf_scene.h"

#include <cmath>

namespace tt3d::asset {

using nlohmann::json;

namespace {

/// A node's matrix, or its translation * rotation * scale.
Matrix local_matrix(const GltfFile& file, const json& node) {
  if (node.contains("matrix")) return file.numbers<16>(node, "matrix", kIdentity);
  return compose(file.numbers<3>(node, "translation", {0, 0, 0}),
                 file.numbers<4>(node, "rotation", {0, 0, 0, 1}),
                 file.numbers<3>(node, "scale", {1, 1, 1}));
}

bool is_hidden(const GltfFile& file, const json& node) {
  const json* visibility = file.extension(node, "KHR_node_visibility");
  return visibility != nullptr && visibility->value("visible", json()) == json(false);
}

/// Row i of N numbers; `fallback` without the attribute.
template <size_t N>
std::array<double, N> row(const AccessorValues& values, size_t i,
                          const std::array<double, N>& fallback) {
  if (values.count == 0) return fallback;
  std::array<double, N> result{};
  for (size_t k = 0; k < N; ++k) result[k] = values.values[N * i + k];
  return result;
}

}  // namespace

GltfScene::GltfScene(const GltfFile& file) : file_(file) {
  std::vector<std::pair<size_t, Matrix>> open;
  for (const size_t root : root_nodes()) open.emplace_back(root, kIdentity);
  std::set<size_t> visited;
  while (!open.empty()) {
    const auto [index, parent] = open.back();
    open.pop_back();
    if (!visited.insert(index).second) {
      file.fail("nodes[" + std::to_string(index) + "] occurs twice; its nodes form a cycle");
    }
    const json& node = file.item("nodes", index);
    if (is_hidden(file, node)) continue;
    const Matrix matrix = multiply(parent, local_matrix(file, node));
    nodes_.push_back({&node, matrix});
    worlds_[index] = matrix;
    for (const size_t child : file.indices(node, "children")) open.emplace_back(child, matrix);
  }
  if (!file.root().contains("skins")) return;
  const json all = file.root().value("nodes", json::array());
  for (size_t i = 0; i < all.size(); ++i) {
    for (const size_t child : file.indices(file.item("nodes", i), "children")) parents_[child] = i;
  }
}

std::vector<size_t> GltfScene::root_nodes() const {
  const json scenes = file_.root().value("scenes", json::array());
  if (!scenes.empty()) {
    const json& scene = file_.item("scenes", file_.whole(file_.root(), "scene", 0));
    return file_.indices(scene, "nodes");
  }
  const json nodes = file_.root().value("nodes", json::array());
  std::set<size_t> children;
  for (size_t i = 0; i < nodes.size(); ++i) {
    for (const size_t child : file_.indices(file_.item("nodes", i), "children")) {
      children.insert(child);
    }
  }
  std::vector<size_t> roots;
  for (size_t i = 0; i < nodes.size(); ++i) {
    if (!children.contains(i)) roots.push_back(i);
  }
  return roots;
}

std::vector<Matrix> GltfScene::placements(const PlacedNode& node) const {
  const json* instancing = file_.extension(*node.node, "EXT_mesh_gpu_instancing");
  if (instancing == nullptr) return {node.world};
  const json attributes = instancing->value("attributes", json::object());
  if (!attributes.is_object()) file_.fail("EXT_mesh_gpu_instancing: attributes must be an object");
  size_t count = 0;
  const auto read = [&](const char* name, const char* type) {
    if (!attributes.contains(name)) return AccessorValues{};
    AccessorValues values = file_.accessor(file_.whole(attributes, name), {type});
    if (count > 0 && values.count != count) {
      file_.fail("EXT_mesh_gpu_instancing: its attributes have different counts");
    }
    count = values.count;
    return values;
  };
  const AccessorValues translations = read("TRANSLATION", "VEC3");
  const AccessorValues rotations = read("ROTATION", "VEC4");
  const AccessorValues scales = read("SCALE", "VEC3");
  if (count == 0) file_.fail("EXT_mesh_gpu_instancing: expected TRANSLATION, ROTATION or SCALE");
  std::vector<Matrix> result;
  for (size_t i = 0; i < count; ++i) {
    std::array<double, 4> q = row<4>(rotations, i, {0, 0, 0, 1});
    const double length = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    if (length > 0) {
      for (double& value : q) value /= length;  // integers are rounded
    }
    result.push_back(multiply(
        node.world, compose(row<3>(translations, i, {0, 0, 0}), q, row<3>(scales, i, {1, 1, 1}))));
  }
  return result;
}

Matrix GltfScene::world_of(size_t node) const {
  Matrix below = kIdentity;
  for (size_t steps = 0; steps <= parents_.size(); ++steps) {
    const auto known = worlds_.find(node);
    if (known != worlds_.end()) return multiply(known->second, below);
    below = multiply(local_matrix(file_, file_.item("nodes", node)), below);
    const auto parent = parents_.find(node);
    if (parent == parents_.end()) return below;
    node = parent->second;
  }
  file_.fail("nodes[" + std::to_string(node) + "] occurs twice; its nodes form a cycle");
}

std::vector<Matrix> GltfScene::joint_matrices(size_t skin) const {
  const json& item = file_.item("skins", skin);
  const std::vector<size_t> joints = file_.indices(item, "joints");
  AccessorValues inverse;
  if (item.contains("inverseBindMatrices")) {
    inverse = file_.accessor(file_.whole(item, "inverseBindMatrices"), {"MAT4"});
    if (inverse.count < joints.size()) file_.fail("a skin has fewer matrices than joints");
  }
  std::vector<Matrix> result;
  for (size_t i = 0; i < joints.size(); ++i) {
    result.push_back(multiply(world_of(joints[i]), row<16>(inverse, i, kIdentity)));
  }
  return result;
}

}  // namespace tt3d::asset
