#include <ATen/ATen.h>

#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>
#include <unordered_map>

#include "tt3d/asset.h"
#include "tt3d/core.h"
#include "tt3d/image.h"
#include "tt3d/surface.h"
#include "tt3d/version.h"

// glTF 2.0 specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html

namespace tt3d::asset {
namespace {

using nlohmann::ordered_json;
using Vec3 = std::array<float, 3>;

constexpr int kFloat = 5126;
constexpr int kUnsignedInt = 5125;
constexpr int kArrayBuffer = 34962;
constexpr int kElementArrayBuffer = 34963;

/// The mesh in glTF's layout: one index for position, normal and uv.
struct Interleaved {
  std::vector<Vec3> positions, normals;  ///< Y-up
  std::vector<std::array<float, 2>> uvs;
  std::vector<uint32_t> indices;
};

Vec3 to_y_up(const float* p) { return {p[0], p[2], -p[1]}; }

/// Unit normals of the vertices, Y-up: the area-weighted mean of the adjacent faces' normals.
std::vector<Vec3> corner_normals(const at::Tensor& vertices, const at::Tensor& faces) {
  const float* v = vertices.const_data_ptr<float>();
  const int32_t* f = faces.const_data_ptr<int32_t>();
  std::vector<std::array<double, 3>> sums(static_cast<size_t>(vertices.size(0)));
  for (int64_t i = 0; i < faces.size(0); ++i, f += 3) {
    double e[3], g[3];
    for (int a = 0; a < 3; ++a) {
      e[a] = double{v[3 * f[1] + a]} - v[3 * f[0] + a];
      g[a] = double{v[3 * f[2] + a]} - v[3 * f[0] + a];
    }
    const double n[3] = {e[1] * g[2] - e[2] * g[1], e[2] * g[0] - e[0] * g[2],
                         e[0] * g[1] - e[1] * g[0]};
    for (int k = 0; k < 3; ++k) {
      for (int a = 0; a < 3; ++a) sums[static_cast<size_t>(f[k])][a] += n[a];
    }
  }
  std::vector<Vec3> normals;
  for (const auto& s : sums) {
    const double length = std::sqrt(s[0] * s[0] + s[1] * s[1] + s[2] * s[2]);
    const float unit[3] = {static_cast<float>(s[0] / length), static_cast<float>(s[1] / length),
                           static_cast<float>(s[2] / length)};
    normals.push_back(length > 0 ? to_y_up(unit) : Vec3{0, 1, 0});
  }
  return normals;
}

/// One output vertex for each pair of vertex and uv that a face uses, in order of appearance.
Interleaved interleave(const at::Tensor& vertices, const at::Tensor& faces, const at::Tensor& uvs,
                       const at::Tensor& uv_faces) {
  const float* v = vertices.const_data_ptr<float>();
  const float* t = uvs.const_data_ptr<float>();
  const int32_t* f = faces.const_data_ptr<int32_t>();
  const int32_t* g = uv_faces.const_data_ptr<int32_t>();
  const std::vector<Vec3> normals = corner_normals(vertices, faces);
  Interleaved out;
  std::unordered_map<uint64_t, uint32_t> known;
  known.reserve(static_cast<size_t>(uvs.size(0)));
  for (int64_t i = 0; i < faces.numel(); ++i) {
    const uint64_t key = (static_cast<uint64_t>(f[i]) << 32) | static_cast<uint32_t>(g[i]);
    const auto [entry, fresh] = known.try_emplace(key, static_cast<uint32_t>(out.positions.size()));
    if (fresh) {
      out.positions.push_back(to_y_up(v + 3 * int64_t{f[i]}));
      out.normals.push_back(normals[static_cast<size_t>(f[i])]);
      out.uvs.push_back({t[2 * int64_t{g[i]}], t[2 * int64_t{g[i]} + 1]});
    }
    out.indices.push_back(entry->second);
  }
  return out;
}

/// The binary chunk and the JSON that describes its parts.
class Buffer {
 public:
  /// Appends data as a buffer view of its own, 4-byte aligned; returns its index.
  size_t add_view(const void* data, size_t size, int target) {
    ordered_json view = {{"buffer", 0}, {"byteOffset", bytes_.size()}, {"byteLength", size}};
    if (target != 0) view["target"] = target;
    views_.push_back(view);
    bytes_.append(static_cast<const char*>(data), size);
    bytes_.resize((bytes_.size() + 3) / 4 * 4, '\0');
    return views_.size() - 1;
  }

  /// Appends an array of N-vectors as view and accessor; returns the accessor's index.
  template <size_t N>
  size_t add_vectors(const std::vector<std::array<float, N>>& values, bool with_bounds) {
    ordered_json accessor = {
        {"bufferView", add_view(values.data(), values.size() * sizeof values[0], kArrayBuffer)},
        {"componentType", kFloat},
        {"count", values.size()},
        {"type", N == 2 ? "VEC2" : "VEC3"}};
    if (with_bounds) {
      std::array<float, N> low = values[0], high = values[0];
      for (const auto& value : values) {
        for (size_t a = 0; a < N; ++a) {
          low[a] = std::min(low[a], value[a]);
          high[a] = std::max(high[a], value[a]);
        }
      }
      accessor["min"] = low;
      accessor["max"] = high;
    }
    accessors_.push_back(accessor);
    return accessors_.size() - 1;
  }

  size_t add_indices(const std::vector<uint32_t>& indices) {
    accessors_.push_back(
        {{"bufferView", add_view(indices.data(), 4 * indices.size(), kElementArrayBuffer)},
         {"componentType", kUnsignedInt},
         {"count", indices.size()},
         {"type", "SCALAR"}});
    return accessors_.size() - 1;
  }

  void describe(ordered_json& root) const {
    root["accessors"] = accessors_;
    root["bufferViews"] = views_;
    root["buffers"] = ordered_json::array();
    root["buffers"][0]["byteLength"] = bytes_.size();
  }
  [[nodiscard]] const std::string& bytes() const { return bytes_; }

 private:
  std::string bytes_;
  ordered_json views_ = ordered_json::array();
  ordered_json accessors_ = ordered_json::array();
};

void append_u32(std::string& bytes, size_t value) {
  const auto narrow = static_cast<uint32_t>(value);
  bytes.append(reinterpret_cast<const char*>(&narrow), sizeof narrow);
}

/// Header, JSON chunk (padded with spaces) and binary chunk (already padded).
std::string make_container(std::string json, const std::string& binary) {
  json.resize((json.size() + 3) / 4 * 4, ' ');
  std::string glb = "glTF";
  append_u32(glb, 2);
  append_u32(glb, 12 + 8 + json.size() + 8 + binary.size());
  append_u32(glb, json.size());
  glb += "JSON" + json;
  append_u32(glb, binary.size());
  glb.append("BIN\0", 4);
  return glb + binary;
}

ordered_json list(const ordered_json& only) { return ordered_json::array({only}); }

ordered_json describe_material() {
  ordered_json material;
  material["name"] = "baked";
  material["pbrMetallicRoughness"]["baseColorTexture"]["index"] = 0;
  material["pbrMetallicRoughness"]["metallicFactor"] = 0;
  material["pbrMetallicRoughness"]["roughnessFactor"] = 1;
  material["extensions"]["KHR_materials_unlit"] = ordered_json::object();
  return material;
}

ordered_json describe_mesh(const Interleaved& parts, Buffer& buffer) {
  ordered_json primitive;
  primitive["attributes"]["POSITION"] = buffer.add_vectors(parts.positions, true);
  primitive["attributes"]["NORMAL"] = buffer.add_vectors(parts.normals, false);
  primitive["attributes"]["TEXCOORD_0"] = buffer.add_vectors(parts.uvs, false);
  primitive["indices"] = buffer.add_indices(parts.indices);
  primitive["material"] = 0;
  primitive["mode"] = 4;
  return {{"name", "object"}, {"primitives", list(primitive)}};
}

/// The node of the mesh. The vertices of a mesh far from the world's origin are relative to
/// `origin`.
ordered_json describe_node(const std::array<double, 3>& origin) {
  ordered_json node = {{"mesh", 0}, {"name", "object"}};
  if (origin != std::array{0.0, 0.0, 0.0}) {
    node["translation"] = {origin[0], origin[2], -origin[1]};
  }
  return node;
}

ordered_json describe_scene(const Interleaved& parts, const std::array<double, 3>& origin,
                            const std::string& png, Buffer& buffer) {
  ordered_json root;
  root["asset"]["version"] = "2.0";
  root["asset"]["generator"] = std::string("tt3d ") + kVersion;
  root["extensionsUsed"] = list("KHR_materials_unlit");
  root["scene"] = 0;
  root["scenes"] = list({{"nodes", list(0)}});
  root["nodes"] = list(describe_node(origin));
  root["meshes"] = list(describe_mesh(parts, buffer));
  root["materials"] = list(describe_material());
  root["textures"] = list({{"sampler", 0}, {"source", 0}});
  // Linear, with linear mipmaps, clamped to the edge.
  root["samplers"] =
      list({{"magFilter", 9729}, {"minFilter", 9987}, {"wrapS", 33071}, {"wrapT", 33071}});
  const size_t view = buffer.add_view(png.data(), png.size(), 0);
  root["images"] = list({{"bufferView", view}, {"mimeType", "image/png"}});
  buffer.describe(root);
  return root;
}

}  // namespace

void write_glb(const TexturedMesh& mesh, const std::filesystem::path& path) {
  check_mesh(mesh, path);
  const Interleaved parts =
      interleave(mesh.vertices.cpu().contiguous(), mesh.faces.cpu().contiguous(),
                 mesh.map.uvs.cpu().contiguous(), mesh.map.faces.cpu().contiguous());
  Buffer buffer;
  const ordered_json root =
      describe_scene(parts, mesh.origin, image::encode_png(mesh.texture), buffer);
  if (buffer.bytes().size() > std::numeric_limits<uint32_t>::max() / 2) {
    throw ResourceError(path.string() + ": the mesh is too large for a GLB file");
  }
  write_file_atomic(path, make_container(root.dump(), buffer.bytes()));
}

}  // namespace tt3d::asset
