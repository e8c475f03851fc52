#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>

#include "appearance_file.h"
#include "tt3d/raster.h"
#include "tt3d/surface.h"

namespace tt3d::object {

using at::Tensor;
using NamedTensors = std::vector<std::pair<std::string, Tensor>>;

namespace {

constexpr const char* kUvs = "uvs";
constexpr const char* kUvFaces = "uv_faces";
constexpr const char* kNormals = "normals";
constexpr const char* kRepeats = "repeats";

/// Samples texels [S,S,3] bilinearly at uv [P,2]: [P,3]. Coordinates wrap around.
Tensor base_up(const Tensor& texels, const Tensor& uv) {
  const Tensor everywhere = at::ones({1, 1, uv.size(0), 4}, uv.options());
  return raster::texture(texels, uv.view({1, 1, -1, 2}), Tensor(), everywhere).view({-1, 3});
}

}  // namespace

Tensor at_points(const Tensor& values, const raster::SurfacePoints& points, const Tensor& faces) {
  return raster::interpolate(values, points.rast.view({1, 1, -1, 4}), faces)
      .view({-1, values.size(1)})
      .t();
}

// ---- A texture over a map -----------------------------------------------------------------

Tensor TextureAppearance::color(const raster::SurfacePoints& points) const {
  const Tensor uv = at_points(map_.uvs, points, map_.faces).t().contiguous();
  return base_up(texels_, uv).t();
}

void TextureAppearance::constrain() const {
  at::NoGradGuard guard;
  texels_.clamp_(0, 1);
}

std::unique_ptr<Appearance> TextureAppearance::clone() const {
  return std::make_unique<TextureAppearance>(texels_.detach().clone(), map_, part_);
}

std::unique_ptr<Appearance> TextureAppearance::to(at::Device device) const {
  return std::make_unique<TextureAppearance>(texels_.detach().to(device), map_.to(device), part_);
}

NamedTensors TextureAppearance::tensors() const {
  return {{name_of(part_), texels_}, {kUvs, map_.uvs}, {kUvFaces, map_.faces}};
}

// ---- A tile along three axes --------------------------------------------------------------

Tensor TriplanarAppearance::color(const raster::SurfacePoints& points) const {
  // Weights of the three planes. Powers of the normal keep the blending zones narrow.
  constexpr double kSharpness = 4;
  const Tensor normal = at_points(normals_, points, faces_);
  const Tensor facing = normal.abs().pow(kSharpness);
  const Tensor share = facing / facing.sum(0, true).clamp_min(1e-12);
  const Tensor place = (points.positions + 1) * (repeats_ / 2);
  Tensor color;
  for (int axis = 0; axis < 3; ++axis) {
    const Tensor uv =
        at::stack({place.select(1, (axis + 1) % 3), place.select(1, (axis + 2) % 3)}, 1);
    const Tensor seen = base_up(tile_, uv).t() * share[axis];
    color = color.defined() ? color + seen : seen;
  }
  return color;
}

void TriplanarAppearance::constrain() const {
  at::NoGradGuard guard;
  tile_.clamp_(0, 1);
}

std::unique_ptr<Appearance> TriplanarAppearance::clone() const {
  return std::make_unique<TriplanarAppearance>(tile_.detach().clone(), normals_, faces_, repeats_);
}

std::unique_ptr<Appearance> TriplanarAppearance::to(at::Device device) const {
  return std::make_unique<TriplanarAppearance>(tile_.detach().to(device), normals_.to(device),
                                               faces_.to(device), repeats_);
}

std::unique_ptr<Appearance> TriplanarAppearance::applied_to(const scene::TriMesh& other) const {
  return std::make_unique<TriplanarAppearance>(
      tile_, scene::vertex_normals(other.vertices, other.faces), other.faces, repeats_);
}

NamedTensors TriplanarAppearance::tensors() const {
  return {{name_of(Part::kTile), tile_},
          {kNormals, normals_},
          {kRepeats, at::tensor({repeats_}, at::kDouble)}};
}

// ---- Files --------------------------------------------------------------------------------

std::unique_ptr<Appearance> read_textured(const TensorFile& file, const Tensor& faces) {
  for (const Part part : {Part::kTexture, Part::kTile}) {
    const std::string name = name_of(part);
    if (!file.tensors.contains(name)) continue;
    const Tensor texels = file.get(name, {-1, -1, 3}, at::kFloat);
    if (file.tensors.contains(kRepeats)) {
      return std::make_unique<TriplanarAppearance>(
          texels, file.get(kNormals, {-1, 3}, at::kFloat), faces,
          file.get(kRepeats, {1}, at::kDouble).item<double>());
    }
    const scene::UvMap map = {file.get(kUvs, {-1, 2}, at::kFloat),
                              file.get(kUvFaces, {faces.size(0), 3}, at::kInt)};
    return std::make_unique<TextureAppearance>(texels, map, part);
  }
  return nullptr;
}

}  // namespace tt3d::object
