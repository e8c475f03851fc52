#include <algorithm>
#include <cmath>

#include "gltf_material.h"
#include "gltf_primitive.h"
#include "gltf_scene.h"

// glTF 2.0 specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html

namespace tt3d::asset {

using nlohmann::json;

namespace {

/// Maximum number of faces and vertices of an asset, after its nodes have repeated its meshes.
constexpr size_t kMaxFaces = size_t{1} << 26;
constexpr size_t kMaxVertices = size_t{1} << 27;

using Triangles = std::vector<std::array<size_t, 3>>;

class GltfReader {
 public:
  explicit GltfReader(const std::filesystem::path& path)
      : file_(path), scene_(file_), materials_(file_, source_.notes) {
    source_.path = path;
    source_.linear_colours = true;
    source_.weld = true;
  }

  AssetSource read() {
    for (const PlacedNode& node : scene_.nodes()) {
      if (node.node->contains("mesh")) add_node(node);
    }
    if (source_.faces.empty()) file_.fail("contains no triangles");
    source_.files = file_.files();
    return std::move(source_);
  }

 private:
  /// The vertices of a primitive in all its places, for the faces that use them.
  struct Placed {
    const Triangles* triangles = nullptr;
    int32_t material = 0, uv_start = -1, colour_start = -1;
  };

  void add_node(const PlacedNode& node) {
    const json& mesh = file_.item("meshes", file_.whole(*node.node, "mesh"));
    const json& primitives = mesh.contains("primitives") ? mesh["primitives"] : kNone;
    if (!primitives.is_array()) file_.fail("primitives: expected an array");
    const std::vector<double> weights = morph_weights(file_, *node.node, mesh);
    const std::vector<Matrix> places = scene_.placements(node);
    for (const json& item : primitives) {
      const GltfPrimitive primitive(file_, item, weights);
      const Triangles triangles = primitive.triangles();
      if (triangles.empty()) continue;
      const std::vector<Vector> positions = primitive.positions();
      Placed placed = add_appearance(primitive);
      placed.triangles = &triangles;
      if (node.node->contains("skin")) {
        add_skinned(primitive, positions, file_.whole(*node.node, "skin"), placed);
        continue;
      }
      for (const Matrix& place : places) {
        const size_t start = begin_vertices(positions.size(), triangles.size());
        for (const Vector& p : positions) add_vertex(transform(place, p));
        const bool mirrored = determinant(place) < 0;
        for (const auto& corners : triangles) add_face(placed, start, corners, mirrored);
      }
    }
  }

  /// A skinned mesh follows its joints alone: its node's own transform does not count.
  void add_skinned(const GltfPrimitive& primitive, const std::vector<Vector>& positions,
                   size_t skin, const Placed& placed) {
    const auto [entry, fresh] = joints_.try_emplace(skin);
    if (fresh) entry->second = scene_.joint_matrices(skin);
    const std::vector<Matrix> matrices = primitive.skin(entry->second);
    const size_t start = begin_vertices(positions.size(), placed.triangles->size());
    for (size_t i = 0; i < positions.size(); ++i) add_vertex(transform(matrices[i], positions[i]));
    for (const auto& corners : *placed.triangles) {
      add_face(placed, start, corners, determinant(matrices[corners[0]]) < 0);
    }
  }

  /// Checks that so many vertices and faces fit; returns the index of the first vertex.
  size_t begin_vertices(size_t vertices, size_t faces) const {
    if (source_.faces.size() + faces > kMaxFaces) file_.fail("has too many faces");
    if (source_.positions.size() + vertices > kMaxVertices) file_.fail("has too many vertices");
    return source_.positions.size();
  }

  void add_vertex(const Vector& q) { source_.positions.push_back({q[0], -q[2], q[1]}); }

  void add_face(const Placed& placed, size_t start, std::array<size_t, 3> corners, bool mirrored) {
    if (mirrored) std::swap(corners[1], corners[2]);
    SourceFace face;
    face.material = placed.material;
    for (size_t k = 0; k < 3; ++k) {
      const auto corner = static_cast<int32_t>(corners[k]);
      face.vertices[k] = static_cast<int32_t>(start) + corner;
      if (placed.uv_start >= 0) face.uvs[k] = placed.uv_start + corner;
      if (placed.colour_start >= 0) face.colours[k] = placed.colour_start + corner;
    }
    source_.faces.push_back(face);
  }

  /// Appends the uvs and vertex colours of a primitive and finds its material.
  Placed add_appearance(const GltfPrimitive& primitive) {
    Placed placed;
    const GltfMaterial& material = materials_.get(primitive.material());
    std::vector<std::array<float, 3>> colours = primitive.colours();
    if (material.emission) colours.clear();
    std::array<float, 3> single{1, 1, 1};
    const bool uniform = std::all_of(colours.begin(), colours.end(),
                                     [&](const auto& colour) { return colour == colours[0]; });
    if (uniform && !colours.empty()) {
      single = colours[0];
      colours.clear();
    }
    if (!colours.empty()) placed.colour_start = static_cast<int32_t>(source_.colours.size());
    source_.colours.insert(source_.colours.end(), colours.begin(), colours.end());

    const auto [entry, fresh] = used_.try_emplace({primitive.material(), single},
                                                  static_cast<int32_t>(source_.materials.size()));
    if (fresh) source_.materials.push_back(materials_.source(material, single));
    placed.material = entry->second;
    placed.uv_start = add_uvs(primitive, material);
    return placed;
  }

  /// Appends the uvs that the material uses; returns the index of the first, or -1 without uvs.
  int32_t add_uvs(const GltfPrimitive& primitive, const GltfMaterial& material) {
    if (!primitive.has(material.uv_set)) {
      if (material.image.defined()) {
        source_.notes.insert(file_.path().string() + ": a mesh has no " + material.uv_set +
                             " for its texture; it gets the texture's first colour");
      }
      return -1;
    }
    const auto start = static_cast<int32_t>(source_.uvs.size());
    const auto& t = material.transform;
    for (const auto& [u, v] : primitive.uvs(material.uv_set)) {
      const std::array<float, 2> uv = {static_cast<float>(t[0] * u + t[1] * v + t[2]),
                                       static_cast<float>(t[3] * u + t[4] * v + t[5])};
      if (!std::isfinite(uv[0]) || !std::isfinite(uv[1])) {
        file_.fail("contains a uv that is not finite");
      }
      source_.uvs.push_back(uv);
    }
    return start;
  }

  inline static const json kNone = json::array();
  GltfFile file_;
  AssetSource source_;
  GltfScene scene_;
  GltfMaterials materials_;
  std::map<std::pair<std::optional<size_t>, std::array<float, 3>>, int32_t> used_;
  std::map<size_t, std::vector<Matrix>> joints_;
};

}  // namespace

AssetSource read_gltf(const std::filesystem::path& path) { return GltfReader(path).read(); }

}  // namespace tt3d::asset
