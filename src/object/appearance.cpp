#include "tt3d/appearance.h"
#include "tt3d/raster.h"
#include "tt3d/surface.h"

#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>

#include "appearance_file.h"

namespace tt3d::object {
namespace {

using at::Tensor;
using NamedTensors = std::vector<std::pair<std::string, Tensor>>;

constexpr const char* kVertexColors = "vertex_colors";
constexpr const char* kMask = "mask";
constexpr const char* kOutside =
    "outside.";  // prefix of the tensors of the appearance outside the mask

/// Each vertex as a surface point on its first triangle.
raster::SurfacePoints vertex_points(const scene::TriMesh& mesh) {
  const int64_t vertices = mesh.vertices.size(0), corners = mesh.faces.numel();
  const Tensor number = at::arange(corners, mesh.faces.options().dtype(at::kLong));
  const Tensor corner = at::full({vertices}, corners - 1, number.options())
                            .scatter_reduce(0, mesh.faces.flatten().to(at::kLong), number, "amin");
  const Tensor place = corner % 3, triangle = corner.div(3, "floor") + 1;
  const Tensor rast = at::stack({place == 0, place == 1, at::zeros_like(place), triangle}, 1);
  return {mesh.vertices, rast.to(mesh.vertices.dtype())};
}

}  // namespace

std::vector<Tensor> Appearance::parameters() const {
  std::vector<Tensor> all;
  for (const ParameterGroup& g : groups())
    all.insert(all.end(), g.tensors.begin(), g.tensors.end());
  return all;
}

std::unique_ptr<Appearance> Appearance::applied_to(const scene::TriMesh& /*other*/) const {
  return nullptr;
}

// ---- Grid and MLP -------------------------------------------------------------------------

Tensor GridMlpAppearance::color(const raster::SurfacePoints& points) const {
  return network_.color(points.positions);
}

std::vector<ParameterGroup> GridMlpAppearance::groups() const {
  return {{Part::kGrid, {network_.grid}}, {Part::kMlp, network_.color_mlp}};
}

std::unique_ptr<Appearance> GridMlpAppearance::clone() const {
  return std::make_unique<GridMlpAppearance>(network_.clone());
}

std::unique_ptr<Appearance> GridMlpAppearance::to(at::Device device) const {
  return std::make_unique<GridMlpAppearance>(network_.to(device));
}

NamedTensors GridMlpAppearance::tensors() const {
  const field::HashGridShape& h = network_.shape;
  NamedTensors named = {
      {"grid_shape", at::tensor({h.levels, h.base, h.finest, h.log2_size, h.features}, at::kLong)}};
  const auto all = network_.parameters();
  for (size_t i = 0; i < all.size(); ++i) {
    named.emplace_back("appearance." + std::to_string(i), all[i]);
  }
  return named;
}

namespace {

std::unique_ptr<Appearance> read_grid_mlp(const TensorFile& file) {
  const Tensor shape = file.get("grid_shape", {5}, at::kLong);
  const auto* n = shape.const_data_ptr<int64_t>();
  field::GridMlp network = {
      {n[0], n[1], n[2], n[3], n[4]}, file.get("appearance.0", {-1, -1}, at::kFloat), {}};
  for (int i = 1; i <= 3; ++i) {
    network.color_mlp.push_back(file.get("appearance." + std::to_string(i), {-1, -1}, at::kFloat));
  }
  return std::make_unique<GridMlpAppearance>(std::move(network));
}

}  // namespace

// ---- Vertex colours -----------------------------------------------------------------------

std::unique_ptr<Appearance> VertexColorAppearance::sample(const Appearance& other,
                                                          const scene::TriMesh& mesh) {
  at::NoGradGuard guard;
  return std::make_unique<VertexColorAppearance>(other.color(vertex_points(mesh)).t().contiguous(),
                                                 mesh.faces);
}

Tensor VertexColorAppearance::color(const raster::SurfacePoints& points) const {
  return raster::interpolate(colors_, points.rast.view({1, 1, -1, 4}), faces_).view({-1, 3}).t();
}

std::vector<ParameterGroup> VertexColorAppearance::groups() const {
  return {{Part::kVertexColors, {colors_}}};
}

void VertexColorAppearance::constrain() const {
  at::NoGradGuard guard;
  colors_.clamp_(0, 1);
}

std::unique_ptr<Appearance> VertexColorAppearance::clone() const {
  return std::make_unique<VertexColorAppearance>(colors_.detach().clone(), faces_);
}

std::unique_ptr<Appearance> VertexColorAppearance::to(at::Device device) const {
  return std::make_unique<VertexColorAppearance>(colors_.detach().to(device), faces_.to(device));
}

NamedTensors VertexColorAppearance::tensors() const { return {{kVertexColors, colors_}}; }

// ---- Masks --------------------------------------------------------------------------------

Tensor MaskedAppearance::color(const raster::SurfacePoints& points) const {
  const Tensor triangle = points.rast.detach().select(1, 3).to(at::kLong) - 1;
  return at::where(mask_.index_select(0, triangle), inside_->color(points),
                   outside_->color(points));
}

std::unique_ptr<Appearance> MaskedAppearance::clone() const {
  return std::make_unique<MaskedAppearance>(inside_->clone(), outside_, mask_);
}

std::unique_ptr<Appearance> MaskedAppearance::to(at::Device device) const {
  return std::make_unique<MaskedAppearance>(inside_->to(device), outside_->to(device),
                                            mask_.to(device));
}

NamedTensors MaskedAppearance::tensors() const {
  NamedTensors named = inside_->tensors();
  named.emplace_back(kMask, mask_.to(at::kByte));
  append_prefixed(named, kOutside, *outside_);
  return named;
}

// ---- Files --------------------------------------------------------------------------------

void append_prefixed(NamedTensors& named, const std::string& prefix, const Appearance& other) {
  for (const auto& [name, tensor] : other.tensors()) named.emplace_back(prefix + name, tensor);
}

TensorFile without_prefix(const TensorFile& file, const std::string& prefix) {
  TensorFile rest = {file.path, {}, {}};
  for (const auto& [name, tensor] : file.tensors) {
    if (name.starts_with(prefix)) rest.tensors[name.substr(prefix.size())] = tensor;
  }
  return rest;
}

namespace {

std::unique_ptr<Appearance> read_unmasked(const TensorFile& file, const Tensor& faces) {
  if (auto found = read_textured(file, faces)) return found;
  if (auto found = read_shaded(file, faces)) return found;
  if (!file.tensors.contains(kVertexColors)) return read_grid_mlp(file);
  return std::make_unique<VertexColorAppearance>(file.get(kVertexColors, {-1, 3}, at::kFloat),
                                                 faces);
}

}  // namespace

std::unique_ptr<Appearance> read_appearance(const TensorFile& file, const Tensor& faces) {
  auto inside = read_unmasked(file, faces);
  if (!file.tensors.contains(kMask)) return inside;
  return std::make_unique<MaskedAppearance>(
      std::move(inside), read_unmasked(without_prefix(file, kOutside), faces),
      file.get(kMask, {faces.size(0)}, at::kByte).to(at::kBool));
}

}  // namespace tt3d::object
