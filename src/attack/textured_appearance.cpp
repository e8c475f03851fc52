#include <ATen/ATen.h>

#include "looks.h"

namespace tt3d {

using at::Tensor;
using NamedTensors = std::vector<std::pair<std::string, Tensor>>;

namespace {

constexpr const char* kTexture = "texture";
constexpr const char* kTile = "tile";
constexpr const char* kUvs = "uvs";
constexpr const char* kUvFaces = "uv_faces";
constexpr const char* kNormals = "normals";
constexpr const char* kRepeats = "repeats";

/// Texels [S,S,3] at places uv [P,2]: [P,3]. Places wrap around.
Tensor look_up(const Tensor& texels, const Tensor& uv) {
  const Tensor everywhere = at::ones({1, 1, uv.size(0), 4}, uv.options());
  return texture(texels, uv.view({1, 1, -1, 2}), Tensor(), everywhere).view({-1, 3});
}

}  // namespace

Tensor at_points(const Tensor& values, const SurfacePoints& points, const Tensor& faces) {
  return interpolate(values, points.rast.view({1, 1, -1, 4}), faces).view({-1, values.size(1)}).t();
}

TextureMap TextureMap::to(at::Device device) const { return {uvs.to(device), uv_faces.to(device)}; }

// ---- A texture over a map -----------------------------------------------------------------

Tensor TextureAppearance::color(const SurfacePoints& points) const {
  const Tensor uv = at_points(map_.uvs, points, map_.uv_faces).t().contiguous();
  return look_up(texels_, uv).t();
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
  return {{part_, texels_}, {kUvs, map_.uvs}, {kUvFaces, map_.uv_faces}};
}

// ---- A tile along three axes --------------------------------------------------------------

Tensor TriplanarAppearance::color(const SurfacePoints& points) const {
  // Which planes face the surface: powers of the normal keep the zones of mixing narrow.
  constexpr double kSharpness = 4;
  const Tensor normal = at_points(normals_, points, faces_);
  const Tensor facing = normal.abs().pow(kSharpness);
  const Tensor share = facing / facing.sum(0, true).clamp_min(1e-12);
  const Tensor place = (points.positions + 1) * (repeats_ / 2);
  Tensor color;
  for (int axis = 0; axis < 3; ++axis) {
    const Tensor uv =
        at::stack({place.select(1, (axis + 1) % 3), place.select(1, (axis + 2) % 3)}, 1);
    const Tensor seen = look_up(tile_, uv).t() * share[axis];
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

std::unique_ptr<Appearance> TriplanarAppearance::worn_by(const TriMesh& other) const {
  return std::make_unique<TriplanarAppearance>(tile_, vertex_normals(other.vertices, other.faces),
                                               other.faces, repeats_);
}

NamedTensors TriplanarAppearance::tensors() const {
  return {{kTile, tile_}, {kNormals, normals_}, {kRepeats, at::tensor({repeats_}, at::kDouble)}};
}

// ---- Files --------------------------------------------------------------------------------

std::unique_ptr<Appearance> read_textured(const TensorFile& file, const Tensor& faces) {
  for (const std::string part : {kTexture, kTile}) {
    if (!file.tensors.contains(part)) continue;
    const Tensor texels = file.get(part, {-1, -1, 3}, at::kFloat);
    if (file.tensors.contains(kRepeats)) {
      return std::make_unique<TriplanarAppearance>(
          texels, file.get(kNormals, {-1, 3}, at::kFloat), faces,
          file.get(kRepeats, {1}, at::kDouble).item<double>());
    }
    const TextureMap map = {file.get(kUvs, {-1, 2}, at::kFloat),
                            file.get(kUvFaces, {faces.size(0), 3}, at::kInt)};
    return std::make_unique<TextureAppearance>(texels, map, part);
  }
  return nullptr;
}

}  // namespace tt3d
