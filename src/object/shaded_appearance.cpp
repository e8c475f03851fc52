#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>

#include "appearance_file.h"
#include "tt3d/lighting.h"
#include "tt3d/raster.h"

namespace tt3d::object {

using at::Tensor;
using NamedTensors = std::vector<std::pair<std::string, Tensor>>;

namespace {

constexpr const char* kMaterial = "material";
constexpr const char* kShading = "shading_normals";
constexpr const char* kLights = "lights";
constexpr const char* kLit = "lit.";  // prefix of the tensors of the lit appearance

}  // namespace

std::unique_ptr<Appearance> ShadedAppearance::evenly_lit(std::shared_ptr<const Appearance> base,
                                                         const Tensor& normals,
                                                         const Tensor& faces) {
  Tensor lights = at::zeros({9, 3}, normals.options());
  lights[0].fill_(1);
  return std::make_unique<ShadedAppearance>(std::move(base), at::ones_like(normals),
                                            normals.clone(), lights, faces);
}

Tensor ShadedAppearance::color(const raster::SurfacePoints& points) const {
  const Tensor light = irradiance(at_points(normals_, points, faces_), lights_);
  return (base_->color(points) * at_points(material_, points, faces_) * light).clamp(0, 1);
}

std::vector<ParameterGroup> ShadedAppearance::groups() const {
  return {{Part::kMaterial, {material_}}, {Part::kNormals, {normals_}}, {Part::kLights, {lights_}}};
}

void ShadedAppearance::constrain() const {
  at::NoGradGuard guard;
  material_.clamp_min_(0);
}

std::unique_ptr<Appearance> ShadedAppearance::clone() const {
  return std::make_unique<ShadedAppearance>(base_, material_.detach().clone(),
                                            normals_.detach().clone(), lights_.detach().clone(),
                                            faces_);
}

std::unique_ptr<Appearance> ShadedAppearance::to(at::Device device) const {
  return std::make_unique<ShadedAppearance>(base_->to(device), material_.detach().to(device),
                                            normals_.detach().to(device),
                                            lights_.detach().to(device), faces_.to(device));
}

NamedTensors ShadedAppearance::tensors() const {
  NamedTensors named = {{kMaterial, material_}, {kShading, normals_}, {kLights, lights_}};
  append_prefixed(named, kLit, *base_);
  return named;
}

std::unique_ptr<Appearance> read_shaded(const TensorFile& file, const Tensor& faces) {
  if (!file.tensors.contains(kMaterial)) return nullptr;
  return std::make_unique<ShadedAppearance>(
      read_appearance(without_prefix(file, kLit), faces), file.get(kMaterial, {-1, 3}, at::kFloat),
      file.get(kShading, {-1, 3}, at::kFloat), file.get(kLights, {9, 3}, at::kFloat), faces);
}

}  // namespace tt3d::object
