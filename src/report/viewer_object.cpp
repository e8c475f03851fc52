#include "viewer_object.h"

#include "html.h"

#include <ATen/ATen.h>

#include <array>
#include <bit>
#include <limits>

#include "tt3d/asset.h"
#include "tt3d/core.h"

namespace tt3d::report {
namespace {

constexpr int64_t kTextureSize = 1024;
constexpr int kTextureQuality = 85;

static_assert(std::endian::native == std::endian::little, "the page's buffers are little-endian");

/// A mesh with one index for position and uv.
struct Corners {
  at::Tensor vertices;  ///< [N] int64 into the vertices of the mesh
  at::Tensor uvs;       ///< [N] int64 into the uvs of the mesh
  at::Tensor indices;   ///< [3F] int64 into both tensors
};

Corners merge_indices(const asset::TexturedMesh& mesh) {
  const int64_t stride = mesh.map.uvs.size(0);
  const at::Tensor keys =
      mesh.faces.to(at::kLong).flatten() * stride + mesh.map.faces.to(at::kLong).flatten();
  const auto [unique, inverse, counts] = at::_unique2(keys, true, true, false);
  return {unique.floor_divide(stride), unique.remainder(stride), inverse};
}

template <typename T>
std::string encoded(const at::Tensor& values) {
  const at::Tensor wide = values.to(at::kLong).contiguous().flatten();
  const auto* from = wide.const_data_ptr<int64_t>();
  std::string bytes(static_cast<size_t>(wide.numel()) * sizeof(T), '\0');
  for (int64_t i = 0; i < wide.numel(); ++i) {
    const auto value = static_cast<T>(from[i]);
    std::memcpy(bytes.data() + static_cast<size_t>(i) * sizeof(T), &value, sizeof(T));
  }
  return base64(bytes);
}

/// Converts [0,1] to 0..65535.
std::string encoded_shares(const at::Tensor& values) {
  return encoded<uint16_t>((values.clamp(0, 1) * std::numeric_limits<uint16_t>::max()).round());
}

nlohmann::json triple(const at::Tensor& values) {
  nlohmann::json json = nlohmann::json::array();
  for (int64_t i = 0; i < 3; ++i) json.push_back(values[i].item<double>());
  return json;
}

}  // namespace

nlohmann::json viewer_object(const asset::TexturedMesh& mesh, const std::string& name) {
  const Corners corners = merge_indices(mesh);
  const at::Tensor positions = mesh.vertices.to(at::kDouble).index_select(0, corners.vertices);
  const at::Tensor low = std::get<0>(positions.min(0));
  const at::Tensor size = (std::get<0>(positions.max(0)) - low).clamp_min(1e-12);
  return {{"name", name},
          {"low", triple(low)},
          {"size", triple(size)},
          {"positions", encoded_shares((positions - low) / size)},
          {"uvs", encoded_shares(mesh.map.uvs.to(at::kDouble).index_select(0, corners.uvs))},
          {"indices", encoded<uint32_t>(corners.indices)},
          {"texture", jpeg_address(mesh.texture, kTextureSize, kTextureQuality)}};
}

}  // namespace tt3d::report
