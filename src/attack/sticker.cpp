#include "sticker.h"

#include <ATen/ATen.h>

#include <cmath>
#include <functional>
#include <numbers>
#include <queue>
#include <utility>
#include <vector>

#include "tt3d/raster.h"
#include "tt3d/surface.h"

namespace tt3d::attack {
namespace {

using at::Tensor;

/// The geometry of the faces, on the host, for growing along the surface.
struct FaceTable {
  Tensor centres;     ///< [F,3] float64
  Tensor areas;       ///< [F] float64
  Tensor neighbours;  ///< [F,3] int32, 3 * face + edge, or -1

  explicit FaceTable(const scene::TriMesh& mesh) {
    const Tensor faces = mesh.faces.cpu();
    const Tensor corners = mesh.vertices.detach()
                               .cpu()
                               .to(at::kDouble)
                               .index_select(0, faces.flatten().to(at::kLong))
                               .view({-1, 3, 3});
    const Tensor a = corners.select(1, 0);
    const Tensor across = at::cross(corners.select(1, 1) - a, corners.select(1, 2) - a, 1);
    centres = corners.mean(1).contiguous();
    areas = across.norm(2, {1}).div(2).contiguous();
    neighbours = raster::edge_twins(faces).contiguous();
  }
  [[nodiscard]] double distance(int64_t f, int64_t g) const {
    const auto *a = centres.const_data_ptr<double>() + 3 * f,
               *b = centres.const_data_ptr<double>() + 3 * g;
    return std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
  }
};

int64_t furthest_face(const FaceTable& table, double azimuth_deg, double elevation_deg) {
  const double azimuth = azimuth_deg * std::numbers::pi / 180;
  const double elevation = elevation_deg * std::numbers::pi / 180;
  const Tensor direction =
      at::tensor({std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth),
                  std::sin(elevation)},
                 at::kDouble);
  return at::matmul(table.centres, direction).argmax().item<int64_t>();
}

}  // namespace

Tensor sticker_faces(const scene::TriMesh& mesh, double area, double azimuth_deg,
                     double elevation_deg) {
  const FaceTable table(mesh);
  const int64_t count = table.areas.size(0);
  const auto* areas = table.areas.const_data_ptr<double>();
  const auto* neighbours = table.neighbours.const_data_ptr<int32_t>();
  Tensor chosen = at::zeros({count}, at::kBool);
  auto* in = chosen.mutable_data_ptr<bool>();
  // Grow from face to face until the area is reached; the neighbour nearest to the first face is
  // added next.
  using Entry = std::pair<double, int64_t>;
  std::priority_queue<Entry, std::vector<Entry>, std::greater<>> front;
  const int64_t first = furthest_face(table, azimuth_deg, elevation_deg);
  front.emplace(0, first);
  double left = area * table.areas.sum().item<double>();
  while (!front.empty() && left > 0) {
    const int64_t face = front.top().second;
    front.pop();
    if (in[face]) continue;
    in[face] = true;
    left -= areas[face];
    for (int edge = 0; edge < 3; ++edge) {
      const int64_t twin = neighbours[3 * face + edge];
      if (twin >= 0 && !in[twin / 3]) front.emplace(table.distance(first, twin / 3), twin / 3);
    }
  }
  return chosen.to(mesh.faces.device());
}

Tensor masked_faces(const scene::UvMap& map, const Tensor& mask) {
  const Tensor picture = mask.cpu().to(at::kFloat);
  const Tensor light =
      (picture.narrow(2, 0, 3).mean(2) >= 128).logical_and(picture.select(2, 3) >= 128);
  const Tensor corners = map.faces.cpu().flatten().to(at::kLong);
  const Tensor middle = map.uvs.cpu().index_select(0, corners).view({-1, 3, 2}).mean(1);
  const auto texel = [&](int64_t axis, int64_t size) {
    return (middle.select(1, axis) * static_cast<double>(size))
        .floor()
        .to(at::kLong)
        .clamp(0, size - 1);
  };
  const int64_t height = light.size(0), width = light.size(1);
  const Tensor place = texel(1, height) * width + texel(0, width);
  return light.flatten().index_select(0, place).to(map.uvs.device());
}

}  // namespace tt3d::attack
