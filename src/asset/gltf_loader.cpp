#include <cmath>
#include <cstring>
#include <optional>
#include <unordered_map>

#include "gltf_file.h"
#include "tt3d/image.h"

namespace tt3d::asset {

using nlohmann::json;

namespace {

/// Column-major 4x4, as in glTF.
using Matrix = std::array<double, 16>;
constexpr Matrix kIdentity = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
/// Maximum number of faces of an asset, after its nodes have repeated its meshes.
constexpr size_t kMaxFaces = size_t{1} << 26;

Matrix multiply(const Matrix& a, const Matrix& b) {
  Matrix out{};
  for (size_t c = 0; c < 4; ++c) {
    for (size_t r = 0; r < 4; ++r) {
      for (size_t k = 0; k < 4; ++k) out[4 * c + r] += a[4 * k + r] * b[4 * c + k];
    }
  }
  return out;
}

double determinant(const Matrix& m) {
  return m[0] * (m[5] * m[10] - m[9] * m[6]) - m[4] * (m[1] * m[10] - m[9] * m[2]) +
         m[8] * (m[1] * m[6] - m[5] * m[2]);
}

/// A node's matrix, or its translation * rotation * scale.
Matrix local_matrix(const GltfFile& file, const json& node) {
  if (node.contains("matrix")) return file.numbers<16>(node, "matrix", kIdentity);
  const auto t = file.numbers<3>(node, "translation", {0, 0, 0});
  const auto [x, y, z, w] = file.numbers<4>(node, "rotation", {0, 0, 0, 1});
  const auto s = file.numbers<3>(node, "scale", {1, 1, 1});
  return {s[0] * (1 - 2 * (y * y + z * z)),
          s[0] * 2 * (x * y + z * w),
          s[0] * 2 * (x * z - y * w),
          0,
          s[1] * 2 * (x * y - z * w),
          s[1] * (1 - 2 * (x * x + z * z)),
          s[1] * 2 * (y * z + x * w),
          0,
          s[2] * 2 * (x * z + y * w),
          s[2] * 2 * (y * z - x * w),
          s[2] * (1 - 2 * (x * x + y * y)),
          0,
          t[0],
          t[1],
          t[2],
          1};
}

/// Corner triples of a primitive, for every mode; empty for points and lines.
std::vector<std::array<size_t, 3>> triangles(const std::vector<size_t>& corners, size_t mode) {
  std::vector<std::array<size_t, 3>> result;
  const size_t n = corners.size();
  if (mode == 4) {
    for (size_t i = 0; i + 2 < n; i += 3) {
      result.push_back({corners[i], corners[i + 1], corners[i + 2]});
    }
  }
  for (size_t i = 2; i < n && (mode == 5 || mode == 6); ++i) {
    if (mode == 6) {
      result.push_back({corners[0], corners[i - 1], corners[i]});
    } else {
      const size_t odd = i % 2;
      result.push_back({corners[i - 2 + odd], corners[i - 1 - odd], corners[i]});
    }
  }
  return result;
}

class GltfReader {
 public:
  explicit GltfReader(const std::filesystem::path& path) : file_(path) { source_.path = path; }

  AssetSource read() {
    for (const auto& [node, matrix] : collect_nodes()) {
      if (!node->contains("mesh")) continue;
      const json& mesh = file_.item("meshes", file_.whole(*node, "mesh"));
      const json primitives = mesh.value("primitives", json::array());
      if (!primitives.is_array()) file_.fail("primitives: expected an array");
      for (const json& primitive : primitives) add_primitive(primitive, matrix);
    }
    if (source_.faces.empty()) file_.fail("contains no triangles");
    return std::move(source_);
  }

 private:
  using PlacedNode = std::pair<const json*, Matrix>;

  /// The nodes of the scene with their world matrices. The hierarchy must be a forest.
  std::vector<PlacedNode> collect_nodes() {
    std::vector<std::pair<size_t, Matrix>> open;
    for (const size_t root : root_nodes()) open.emplace_back(root, kIdentity);
    std::vector<PlacedNode> placed;
    std::set<size_t> visited;
    while (!open.empty()) {
      const auto [index, parent] = open.back();
      open.pop_back();
      if (!visited.insert(index).second) {
        file_.fail("nodes[" + std::to_string(index) + "] occurs twice; its nodes form a cycle");
      }
      const json& node = file_.item("nodes", index);
      const Matrix matrix = multiply(parent, local_matrix(file_, node));
      placed.emplace_back(&node, matrix);
      for (const size_t child : indices(node, "children")) open.emplace_back(child, matrix);
    }
    return placed;
  }

  /// The root nodes of the default scene; without scenes, all nodes without a parent.
  std::vector<size_t> root_nodes() {
    if (file_.root().contains("scenes")) {
      const json& scene = file_.item("scenes", file_.whole(file_.root(), "scene", 0));
      return indices(scene, "nodes");
    }
    const json nodes = file_.root().value("nodes", json::array());
    std::set<size_t> children;
    for (size_t i = 0; i < nodes.size(); ++i) {
      for (const size_t child : indices(file_.item("nodes", i), "children")) children.insert(child);
    }
    std::vector<size_t> roots;
    for (size_t i = 0; i < nodes.size(); ++i) {
      if (!children.contains(i)) roots.push_back(i);
    }
    return roots;
  }

  std::vector<size_t> indices(const json& object, const char* key) const {
    std::vector<size_t> result;
    const json array = object.value(key, json::array());
    if (!array.is_array()) file_.fail(std::string(key) + ": expected an array");
    for (const json& value : array) {
      if (!value.is_number_unsigned()) file_.fail(std::string(key) + ": expected indices");
      result.push_back(value.get<size_t>());
    }
    return result;
  }

  void add_primitive(const json& primitive, const Matrix& matrix) {
    if (!primitive.is_object() || !primitive.value("attributes", json()).is_object()) {
      file_.fail("a primitive has no attributes");
    }
    const json& attributes = primitive["attributes"];
    const size_t mode = file_.whole(primitive, "mode", 4);
    if (mode < 4 || !attributes.contains("POSITION")) return;
    const AccessorValues positions = file_.accessor(file_.whole(attributes, "POSITION"), {"VEC3"});
    const auto corners = triangles(read_corners(primitive, positions.count), mode);
    if (source_.faces.size() + corners.size() > kMaxFaces) file_.fail("has too many faces");

    const int32_t material = use_material(primitive);
    const std::vector<int32_t> vertices = add_vertices(positions, attributes, matrix);
    const auto uv_start = static_cast<int32_t>(source_.uvs.size());
    const bool has_uvs = add_uvs(attributes, positions.count, material);
    const bool mirrored = determinant(matrix) < 0;
    for (auto [a, b, c] : corners) {
      if (mirrored) std::swap(b, c);
      SourceFace face;
      face.material = material;
      face.vertices = {vertices[a], vertices[b], vertices[c]};
      if (has_uvs) {
        face.uvs = {uv_start + static_cast<int32_t>(a), uv_start + static_cast<int32_t>(b),
                    uv_start + static_cast<int32_t>(c)};
      }
      source_.faces.push_back(face);
    }
  }

  std::vector<size_t> read_corners(const json& primitive, size_t vertex_count) const {
    std::vector<size_t> corners;
    if (!primitive.contains("indices")) {
      for (size_t i = 0; i < vertex_count; ++i) corners.push_back(i);
      return corners;
    }
    const AccessorValues list = file_.accessor(file_.whole(primitive, "indices"), {"SCALAR"});
    for (const double index : list.values) {
      if (!(index >= 0) || index >= static_cast<double>(vertex_count) ||
          index != std::floor(index)) {
        file_.fail("a primitive's index points outside its " + std::to_string(vertex_count) +
                   " vertices");
      }
      corners.push_back(static_cast<size_t>(index));
    }
    return corners;
  }

  /// Positions in the world, +Z up. Vertices with the same position and colour are merged: glTF
  /// splits them along uv seams, and the surface must be closed again.
  std::vector<int32_t> add_vertices(const AccessorValues& positions, const json& attributes,
                                    const Matrix& m) {
    const std::vector<std::array<float, 3>> colours = read_colours(attributes, positions.count);
    std::vector<int32_t> result;
    for (size_t i = 0; i < positions.count; ++i) {
      const double* p = positions.values.data() + 3 * i;
      double q[3];
      for (size_t r = 0; r < 3; ++r) {
        q[r] = m[r] * p[0] + m[4 + r] * p[1] + m[8 + r] * p[2] + m[12 + r];
      }
      // Adding 0 turns -0 into 0, so that equal positions have equal bytes.
      const std::array<float, 3> world = {static_cast<float>(q[0]) + 0.F,
                                          static_cast<float>(-q[2]) + 0.F,
                                          static_cast<float>(q[1]) + 0.F};
      for (const float value : world) {
        if (!std::isfinite(value)) file_.fail("contains a vertex that is not finite");
      }
      result.push_back(weld(world, colours[i]));
    }
    return result;
  }

  int32_t weld(const std::array<float, 3>& position, const std::array<float, 3>& colour) {
    std::string key(reinterpret_cast<const char*>(position.data()), sizeof position);
    key.append(reinterpret_cast<const char*>(colour.data()), sizeof colour);
    const auto [entry, fresh] =
        welded_.try_emplace(std::move(key), static_cast<int32_t>(source_.positions.size()));
    if (fresh) {
      source_.positions.push_back(position);
      source_.colours.push_back(colour);
    }
    return entry->second;
  }

  /// COLOR_0 is in linear light; -1 if absent.
  std::vector<std::array<float, 3>> read_colours(const json& attributes, size_t count) const {
    std::vector<std::array<float, 3>> colours(count, {-1, -1, -1});
    if (!attributes.contains("COLOR_0")) return colours;
    const AccessorValues values =
        file_.accessor(file_.whole(attributes, "COLOR_0"), {"VEC3", "VEC4"});
    if (values.count < count) file_.fail("COLOR_0 has fewer values than POSITION");
    for (size_t i = 0; i < count; ++i) {
      for (size_t a = 0; a < 3; ++a) {
        const double linear = values.values[i * values.width + a];
        colours[i][a] =
            image::linear_to_srgb(std::isfinite(linear) ? static_cast<float>(linear) : 0.F);
      }
    }
    return colours;
  }

  /// Appends the uvs that the material uses; false if the primitive has none.
  bool add_uvs(const json& attributes, size_t count, int32_t material) {
    const GltfMaterial& gltf = materials_[static_cast<size_t>(material)];
    if (!attributes.contains(gltf.uv_set)) return false;
    const AccessorValues uvs =
        file_.accessor(file_.whole(attributes, gltf.uv_set.c_str()), {"VEC2"});
    if (uvs.count < count) file_.fail(gltf.uv_set + " has fewer values than POSITION");
    const auto& t = gltf.transform;
    for (size_t i = 0; i < count; ++i) {
      const double u = uvs.values[2 * i], v = uvs.values[2 * i + 1];
      if (!std::isfinite(u) || !std::isfinite(v)) file_.fail("contains a uv that is not finite");
      source_.uvs.push_back({static_cast<float>(t[0] * u + t[1] * v + t[2]),
                             static_cast<float>(t[3] * u + t[4] * v + t[5])});
    }
    return true;
  }

  /// Index of the primitive's material in the result. The default material is white.
  int32_t use_material(const json& primitive) {
    const std::optional<size_t> index = primitive.contains("material")
                                            ? std::optional(file_.whole(primitive, "material"))
                                            : std::nullopt;
    const auto [entry, fresh] =
        used_.try_emplace(index, static_cast<int32_t>(source_.materials.size()));
    if (fresh) {
      materials_.push_back(index ? read_gltf_material(file_, *index) : GltfMaterial{});
      source_.materials.push_back(materials_.back().material);
    }
    return entry->second;
  }

  GltfFile file_;
  AssetSource source_;
  std::vector<GltfMaterial> materials_;
  std::map<std::optional<size_t>, int32_t> used_;
  std::unordered_map<std::string, int32_t> welded_;
};

}  // namespace

AssetSource read_glb(const std::filesystem::path& path) { return GltfReader(path).read(); }

}  // namespace tt3d::asset
