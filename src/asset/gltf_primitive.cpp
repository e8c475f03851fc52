#include "gltf_primitive.h"

#include <algorithm>
#include <cmath>

namespace tt3d::asset {

using nlohmann::json;

namespace {

/// The attributes of a primitive; InputError if there are none.
const json& attributes_of(const GltfFile& file, const json& primitive) {
  const bool found = primitive.is_object() && primitive.contains("attributes") &&
                     primitive["attributes"].is_object();
  if (!found) file.fail("a primitive has no attributes");
  return primitive["attributes"];
}

}  // namespace

GltfPrimitive::GltfPrimitive(const GltfFile& file, const json& primitive,
                             const std::vector<double>& weights)
    : file_(file),
      primitive_(primitive),
      attributes_(attributes_of(file, primitive)),
      weights_(weights) {
  check_compression();
  if (has("POSITION")) {
    const json& accessor = file.item("accessors", file.whole(attributes_, "POSITION"));
    count_ = file.whole(accessor, "count");
  }
}

/// A compressed primitive may hold its data uncompressed, too. If it does not, its accessors have
/// no buffer view.
void GltfPrimitive::check_compression() const {
  constexpr const char* kDraco = "KHR_draco_mesh_compression";
  if (file_.extension(primitive_, kDraco) == nullptr) return;
  const auto is_empty = [&](const json& object, const char* key) {
    return object.contains(key) &&
           !file_.item("accessors", file_.whole(object, key)).contains("bufferView");
  };
  if (is_empty(attributes_, "POSITION") || is_empty(primitive_, "indices")) {
    file_.fail(std::string("a mesh is compressed with ") + kDraco +
               " (Draco), which tt3d does not read; export without compression");
  }
}

bool GltfPrimitive::has(const std::string& attribute) const {
  return attributes_.contains(attribute);
}

std::optional<size_t> GltfPrimitive::material() const {
  return primitive_.contains("material") ? std::optional(file_.whole(primitive_, "material"))
                                         : std::nullopt;
}

std::vector<size_t> GltfPrimitive::corners() const {
  std::vector<size_t> corners;
  if (!primitive_.contains("indices")) {
    const size_t checked = attribute("POSITION", {"VEC3"}).count;
    for (size_t i = 0; i < checked; ++i) corners.push_back(i);
    return corners;
  }
  const AccessorValues list = file_.accessor(file_.whole(primitive_, "indices"), {"SCALAR"});
  for (const double index : list.values) {
    if (!(index >= 0) || index >= static_cast<double>(count_) || index != std::floor(index)) {
      file_.fail("a primitive's index points outside its " + std::to_string(count_) + " vertices");
    }
    corners.push_back(static_cast<size_t>(index));
  }
  return corners;
}

std::vector<std::array<size_t, 3>> GltfPrimitive::triangles() const {
  std::vector<std::array<size_t, 3>> result;
  const size_t mode = file_.whole(primitive_, "mode", 4);
  if (mode < 4 || !has("POSITION")) return result;
  const std::vector<size_t> c = corners();
  const size_t n = c.size();
  if (mode == 4) {
    for (size_t i = 0; i + 2 < n; i += 3) result.push_back({c[i], c[i + 1], c[i + 2]});
  }
  for (size_t i = 2; i < n && (mode == 5 || mode == 6); ++i) {
    if (mode == 6) {
      result.push_back({c[0], c[i - 1], c[i]});
    } else {
      const size_t odd = i % 2;
      result.push_back({c[i - 2 + odd], c[i - 1 - odd], c[i]});
    }
  }
  return result;
}

/// An attribute with the weighted displacements of the morph targets.
AccessorValues GltfPrimitive::attribute(const std::string& name,
                                        const std::set<std::string>& types) const {
  AccessorValues values = file_.accessor(file_.whole(attributes_, name.c_str()), types);
  if (values.count < count_) file_.fail(name + " has fewer values than POSITION");
  const json targets = primitive_.value("targets", json::array());
  if (!targets.is_array()) file_.fail("targets: expected an array");
  for (size_t i = 0; i < std::min(targets.size(), weights_.size()); ++i) {
    const json& target = targets[i];
    if (!target.is_object()) file_.fail("targets: expected objects");
    if (weights_[i] == 0 || !target.contains(name)) continue;
    const AccessorValues moved = file_.accessor(file_.whole(target, name.c_str()), types);
    if (moved.count < values.count || moved.width != values.width) {
      file_.fail("a morph target's " + name + " does not match the mesh's");
    }
    for (size_t k = 0; k < values.values.size(); ++k) {
      values.values[k] += weights_[i] * moved.values[k];
    }
  }
  return values;
}

std::vector<Vector> GltfPrimitive::positions() const {
  const AccessorValues values = attribute("POSITION", {"VEC3"});
  std::vector<Vector> result;
  result.reserve(values.count);
  for (size_t i = 0; i < values.count; ++i) {
    const double* p = values.values.data() + 3 * i;
    result.push_back({p[0], p[1], p[2]});
  }
  return result;
}

std::vector<Matrix> GltfPrimitive::skin(const std::vector<Matrix>& joints) const {
  if (!has("JOINTS_0") || !has("WEIGHTS_0")) {
    file_.fail("a skinned mesh has no JOINTS_0 and WEIGHTS_0");
  }
  std::vector<Matrix> result(count_, Matrix{});
  std::vector<double> sums(count_, 0);
  for (int set = 0; has("JOINTS_" + std::to_string(set)); ++set) {
    const AccessorValues joint = attribute("JOINTS_" + std::to_string(set), {"VEC4"});
    const AccessorValues weight = attribute("WEIGHTS_" + std::to_string(set), {"VEC4"});
    for (size_t k = 0; k < 4 * count_; ++k) {
      const double w = weight.values[k];
      if (!std::isfinite(w)) file_.fail("contains a skin weight that is not finite");
      if (w == 0) continue;
      if (!(joint.values[k] >= 0) || joint.values[k] >= static_cast<double>(joints.size())) {
        file_.fail("a vertex names a joint outside its skin's " + std::to_string(joints.size()));
      }
      const Matrix& matrix = joints[static_cast<size_t>(joint.values[k])];
      for (size_t e = 0; e < 16; ++e) result[k / 4][e] += w * matrix[e];
      sums[k / 4] += w;
    }
  }
  for (size_t i = 0; i < count_; ++i) {
    if (!(sums[i] > 0)) file_.fail("a vertex of a skinned mesh has no weight");
    for (double& element : result[i]) element /= sums[i];
  }
  return result;
}

std::vector<std::array<float, 3>> GltfPrimitive::colours() const {
  std::vector<std::array<float, 3>> colours;
  if (!has("COLOR_0")) return colours;
  const AccessorValues values = attribute("COLOR_0", {"VEC3", "VEC4"});
  // Integers are fractions of their largest value, also if an exporter forgot to say so.
  const json& accessor = file_.item("accessors", file_.whole(attributes_, "COLOR_0"));
  const size_t type = file_.whole(accessor, "componentType");
  const bool plain = accessor.value("normalized", json()) != json(true);
  const double largest = plain && type == 5121 ? 255 : plain && type == 5123 ? 65535 : 1;
  colours.resize(count_);
  for (size_t i = 0; i < count_; ++i) {
    for (size_t a = 0; a < 3; ++a) {
      const double linear = values.values[i * values.width + a] / largest;
      colours[i][a] = std::isfinite(linear) ? static_cast<float>(std::clamp(linear, 0.0, 1.0)) : 0;
    }
  }
  return colours;
}

std::vector<std::array<double, 2>> GltfPrimitive::uvs(const std::string& set) const {
  const AccessorValues values = attribute(set, {"VEC2"});
  std::vector<std::array<double, 2>> result;
  result.reserve(count_);
  for (size_t i = 0; i < count_; ++i) {
    result.push_back({values.values[2 * i], values.values[2 * i + 1]});
  }
  return result;
}

std::vector<double> morph_weights(const GltfFile& file, const json& node, const json& mesh) {
  std::vector<double> weights;
  const json& owner = node.contains("weights") ? node : mesh;
  const json list = owner.value("weights", json::array());
  if (!list.is_array()) file.fail("weights: expected an array");
  for (const json& weight : list) {
    if (!weight.is_number() || !std::isfinite(weight.get<double>())) {
      file.fail("weights: expected finite numbers");
    }
    weights.push_back(weight.get<double>());
  }
  return weights;
}

}  // namespace tt3d::asset
