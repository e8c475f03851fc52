#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <unordered_map>

#include "asset_source.h"

namespace tt3d::asset {
namespace {

using Float3 = std::array<float, 3>;

template <typename T, size_t N>
at::Tensor to_tensor(const std::vector<std::array<T, N>>& values, at::ScalarType type) {
  at::Tensor tensor = at::empty({std::ssize(values), static_cast<int64_t>(N)}, type);
  T* out = tensor.data_ptr<T>();
  for (const auto& value : values) out = std::copy(value.begin(), value.end(), out);
  return tensor;
}

std::array<double, 3> origin_of(const AssetSource& source) {
  constexpr double kNone = std::numeric_limits<double>::infinity();
  std::array<double, 3> low = {kNone, kNone, kNone}, high = {-kNone, -kNone, -kNone};
  for (const SourceFace& face : source.faces) {
    for (const int32_t vertex : face.vertices) {
      const auto& p = source.positions[static_cast<size_t>(vertex)];
      for (size_t k = 0; k < 3; ++k) {
        low[k] = std::min(low[k], p[k]);
        high[k] = std::max(high[k], p[k]);
      }
    }
  }
  return far_origin(low, high);
}

/// The vertices of an asset as float32, and the new index of each position.
class Vertices {
 public:
  explicit Vertices(bool weld) : weld_(weld) {}

  int32_t add(const Float3& p) {
    const auto next = static_cast<int32_t>(positions_.size());
    if (weld_) {
      std::string key(reinterpret_cast<const char*>(p.data()), sizeof p);
      const auto [entry, fresh] = known_.try_emplace(std::move(key), next);
      if (!fresh) return entry->second;
    }
    positions_.push_back(p);
    return next;
  }
  [[nodiscard]] const std::vector<Float3>& positions() const { return positions_; }

 private:
  bool weld_;
  std::vector<Float3> positions_;
  std::unordered_map<std::string, int32_t> known_;
};

}  // namespace

std::array<double, 3> far_origin(const std::array<double, 3>& low,
                                 const std::array<double, 3>& high) {
  constexpr double kFar = 256;  // float32 then resolves 1/65536 of the box
  double extent = 0, most = 0;
  for (size_t k = 0; k < 3; ++k) {
    extent = std::max(extent, high[k] - low[k]);
    most = std::max({most, std::abs(low[k]), std::abs(high[k])});
  }
  if (!(extent > 0) || most <= kFar * extent) return {0, 0, 0};
  // A multiple of a power of two is exact, and close boxes have the same origin.
  const double step = std::exp2(std::floor(std::log2(extent)));
  std::array<double, 3> origin{};
  for (size_t k = 0; k < 3; ++k) origin[k] = std::round((low[k] + high[k]) / 2 / step) * step;
  return origin;
}

void place_vertices(const AssetSource& source, TexturedMesh& mesh) {
  mesh.origin = origin_of(source);
  Vertices vertices(source.weld);
  std::vector<int32_t> index;
  index.reserve(source.positions.size());
  for (const auto& p : source.positions) {
    Float3 placed{};
    for (size_t k = 0; k < 3; ++k) {
      placed[k] = static_cast<float>(p[k] - mesh.origin[k]);
      if (!std::isfinite(placed[k])) {
        throw InputError(source.path, "contains a vertex that is not finite");
      }
      // Adding 0 turns -0 into 0, so that equal positions have equal bytes.
      if (source.weld) placed[k] += 0.F;
    }
    index.push_back(vertices.add(placed));
  }
  std::vector<std::array<int32_t, 3>> faces;
  faces.reserve(source.faces.size());
  for (const SourceFace& face : source.faces) {
    const auto& v = face.vertices;
    faces.push_back({index[static_cast<size_t>(v[0])], index[static_cast<size_t>(v[1])],
                     index[static_cast<size_t>(v[2])]});
  }
  mesh.vertices = to_tensor(vertices.positions(), at::kFloat);
  mesh.faces = to_tensor(faces, at::kInt);
}

}  // namespace tt3d::asset
