#include <ATen/ATen.h>

#include <cmath>

#include "tt3d/field.h"
#include "tt3d/random_tensor.h"
#include "tt3d/tensor_file.h"

namespace tt3d::field {
namespace {

using at::Tensor;

Tensor initial_tensor(at::IntArrayRef shape, double bound, uint64_t seed, const std::string& name) {
  return uniform_tensor(shape, -bound, bound, Random(seed, "field/" + name).key(), at::kCPU);
}

/// Layers in -> hidden... -> out, initialised He-uniform.
std::vector<Tensor> make_mlp(const std::vector<int64_t>& widths, uint64_t seed,
                             const std::string& name) {
  std::vector<Tensor> weights;
  for (size_t k = 0; k + 1 < widths.size(); ++k) {
    const double bound = std::sqrt(6.0 / static_cast<double>(widths[k]));
    weights.push_back(
        initial_tensor({widths[k + 1], widths[k]}, bound, seed, name + std::to_string(k)));
  }
  return weights;
}

std::vector<int64_t> shape_numbers(const FieldShape& s) {
  return {s.geometry.levels,   s.geometry.base,   s.geometry.finest,   s.geometry.log2_size,
          s.appearance.levels, s.appearance.base, s.appearance.finest, s.appearance.log2_size,
          s.density_hidden,    s.color_hidden,    s.specular_hidden,   s.occupancy};
}

FieldShape shape_from(const std::vector<int64_t>& n) {
  FieldShape s;
  s.geometry = {n[0], n[1], n[2], n[3], 1};
  s.appearance = {n[4], n[5], n[6], n[7], 2};
  s.density_hidden = n[8];
  s.color_hidden = n[9];
  s.specular_hidden = n[10];
  s.occupancy = n[11];
  return s;
}

const std::vector<std::string>& parameter_names() {
  static const std::vector<std::string> names = {
      "geometry.grid",    "geometry.mlp.0",   "geometry.mlp.1",
      "appearance.grid",  "appearance.mlp.0", "appearance.mlp.1",
      "appearance.mlp.2", "specular.mlp.0",   "specular.mlp.1"};
  return names;
}

}  // namespace

Tensor GridMlp::features(const Tensor& x) const {
  return mlp(encode_points(x, grid, shape), color_mlp).sigmoid();
}

Tensor GridMlp::color(const Tensor& x) const { return features(x).narrow(0, 0, 3); }

std::vector<Tensor> GridMlp::parameters() const {
  std::vector<Tensor> all = {grid};
  all.insert(all.end(), color_mlp.begin(), color_mlp.end());
  return all;
}

GridMlp GridMlp::clone() const {
  GridMlp copy = {shape, grid.detach().clone(), {}};
  for (const Tensor& w : color_mlp) copy.color_mlp.push_back(w.detach().clone());
  return copy;
}

GridMlp GridMlp::to(at::Device device) const {
  GridMlp moved = {shape, grid.detach().to(device), {}};
  for (const Tensor& w : color_mlp) moved.color_mlp.push_back(w.detach().to(device));
  return moved;
}

RadianceField RadianceField::create(const FieldShape& shape, uint64_t seed) {
  RadianceField f;
  f.shape = shape;
  constexpr double kGridBound = 1e-4;
  f.geometry_grid = initial_tensor({shape.geometry.entries(), 1}, kGridBound, seed, "geometry");
  f.density_mlp = make_mlp({3 + shape.geometry.levels, shape.density_hidden, 1}, seed, "density");
  f.appearance.shape = shape.appearance;
  f.appearance.grid =
      initial_tensor({shape.appearance.entries(), 2}, kGridBound, seed, "appearance");
  f.appearance.color_mlp = make_mlp(
      {3 + 2 * shape.appearance.levels, shape.color_hidden, shape.color_hidden, 6}, seed, "color");
  f.specular_mlp = make_mlp({6, shape.specular_hidden, 3}, seed, "specular");
  f.occupied = at::ones({shape.occupancy, shape.occupancy, shape.occupancy}, at::kByte);
  return f;
}

Tensor RadianceField::density(const Tensor& x) const {
  // exp of the clamped output, the activation in the official code.
  return mlp(encode_points(x, geometry_grid, shape.geometry), density_mlp)[0].clamp(-15, 15).exp();
}

Tensor RadianceField::color(const Tensor& x, const Tensor& directions, bool with_specular,
                            Tensor* specular_out) const {
  const Tensor features = appearance.features(x);
  const Tensor diffuse = features.narrow(0, 0, 3);
  if (!with_specular) return diffuse;
  const Tensor specular =
      mlp(at::cat({directions.t(), features.narrow(0, 3, 3)}, 0), specular_mlp).sigmoid();
  if (specular_out) *specular_out = specular;
  return (diffuse + specular).clamp(0, 1);
}

RadianceField RadianceField::to(at::Device device) const {
  RadianceField moved = {
      shape, geometry_grid.detach().to(device), {}, appearance.to(device), {}, occupied.to(device)};
  for (const Tensor& w : density_mlp) moved.density_mlp.push_back(w.detach().to(device));
  for (const Tensor& w : specular_mlp) moved.specular_mlp.push_back(w.detach().to(device));
  return moved;
}

std::vector<Tensor> RadianceField::parameters() const {
  std::vector<Tensor> all = {geometry_grid};
  all.insert(all.end(), density_mlp.begin(), density_mlp.end());
  const auto appearance_parameters = appearance.parameters();
  all.insert(all.end(), appearance_parameters.begin(), appearance_parameters.end());
  all.insert(all.end(), specular_mlp.begin(), specular_mlp.end());
  return all;
}

void RadianceField::save(const std::filesystem::path& path) const {
  std::vector<std::pair<std::string, Tensor>> tensors;
  const auto all = parameters();
  for (size_t i = 0; i < all.size(); ++i) tensors.emplace_back(parameter_names()[i], all[i]);
  tensors.emplace_back("occupied", occupied);
  tensors.emplace_back("shape", at::tensor(shape_numbers(shape), at::kLong));
  save_tensors(path, tensors, {{"format", "tt3d field"}});
}

RadianceField RadianceField::load(const std::filesystem::path& path) {
  const TensorFile file = load_tensors(path);
  const Tensor numbers = file.get("shape", {12}, at::kLong);
  FieldShape shape = shape_from(std::vector<int64_t>(
      numbers.const_data_ptr<int64_t>(), numbers.const_data_ptr<int64_t>() + numbers.numel()));
  RadianceField f = create(shape, 0);
  const auto all = f.parameters();
  for (size_t i = 0; i < all.size(); ++i) {
    all[i].copy_(file.get(parameter_names()[i], all[i].sizes(), at::kFloat));
  }
  f.occupied = file.get("occupied", f.occupied.sizes(), at::kByte).clone();
  return f;
}

}  // namespace tt3d::field
