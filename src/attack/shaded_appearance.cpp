#include <ATen/ATen.h>

#include "looks.h"
#include "tt3d/lighting.h"

namespace tt3d {

using at::Tensor;
using NamedTensors = std::vector<std::pair<std::string, Tensor>>;

namespace {

constexpr const char* kMaterial = "material";
constexpr const char* kShading = "shading_normals";
constexpr const char* kLights = "lights";
constexpr const char* kLit = "lit.";  // before the names of the look that is lit

}  // namespace

std::unique_ptr<Appearance> ShadedAppearance::evenly_lit(std::shared_ptr<const Appearance> look,
                                                         const Tensor& normals,
                                                         const Tensor& faces) {
  Tensor lights = at::zeros({9, 3}, normals.options());
  lights[0].fill_(1);
  return std::make_unique<ShadedAppearance>(std::move(look), at::ones_like(normals),
                                            normals.clone(), lights, faces);
}

Tensor ShadedAppearance::color(const SurfacePoints& points) const {
  const Tensor light = irradiance(at_points(normals_, points, faces_), lights_);
  return (look_->color(points) * at_points(material_, points, faces_) * light).clamp(0, 1);
}

std::vector<ParameterGroup> ShadedAppearance::groups() const {
  return {{"material", {material_}}, {"normals", {normals_}}, {"lights", {lights_}}};
}

void ShadedAppearance::constrain() const {
  at::NoGradGuard guard;
  material_.clamp_min_(0);
}

std::unique_ptr<Appearance> ShadedAppearance::clone() const {
  return std::make_unique<ShadedAppearance>(look_, material_.detach().clone(),
                                            normals_.detach().clone(), lights_.detach().clone(),
                                            faces_);
}

std::unique_ptr<Appearance> ShadedAppearance::to(at::Device device) const {
  return std::make_unique<ShadedAppearance>(look_->to(device), material_.detach().to(device),
                                            normals_.detach().to(device),
                                            lights_.detach().to(device), faces_.to(device));
}

NamedTensors ShadedAppearance::tensors() const {
  NamedTensors named = {{kMaterial, material_}, {kShading, normals_}, {kLights, lights_}};
  append_prefixed(named, kLit, *look_);
  return named;
}

std::unique_ptr<Appearance> read_shaded(const TensorFile& file, const Tensor& faces) {
  if (!file.tensors.contains(kMaterial)) return nullptr;
  return std::make_unique<ShadedAppearance>(
      read_appearance(without_prefix(file, kLit), faces), file.get(kMaterial, {-1, 3}, at::kFloat),
      file.get(kShading, {-1, 3}, at::kFloat), file.get(kLights, {9, 3}, at::kFloat), faces);
}

}  // namespace tt3d
