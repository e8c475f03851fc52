#include "attack_state.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <utility>

namespace tt3d {
namespace {

using at::Tensor;

constexpr int64_t kCurveColumns = 8;
constexpr const char* kVertices = "vertices";

}  // namespace

bool optimizes(const AttackOptions& options, const std::string& part) {
  return std::find(options.optimize.begin(), options.optimize.end(), part) !=
         options.optimize.end();
}

const std::vector<std::string>& attack_parts() {
  static const std::vector<std::string> parts = {"grid",    "mlp",    "vertex-colors",
                                                 "texture", "tile",   "material",
                                                 "normals", "lights", kVertices};
  return parts;
}

std::vector<FreeParameter> free_parameters(const AttackState& s, const AttackOptions& options) {
  std::vector<FreeParameter> free;
  if (optimizes(options, kVertices)) free.push_back({s.offsets, options.vertex_rate});
  for (const ParameterGroup& group : s.appearance->groups()) {
    if (!optimizes(options, group.name)) continue;
    for (const Tensor& t : group.tensors) free.push_back({t, options.appearance_rate});
  }
  return free;
}

AttackState fresh_state(const AttackInput& input, const AttackOptions& options) {
  AttackState s;
  s.offsets = at::zeros_like(input.mesh.vertices);
  s.appearance = starting_look(input, options);
  for (const FreeParameter& p : free_parameters(s, options)) {
    s.moment1.push_back(at::zeros_like(p.tensor));
    s.moment2.push_back(at::zeros_like(p.tensor));
    if (options.momentum > 0) s.velocity.push_back(at::zeros_like(p.tensor));
    p.tensor.requires_grad_(true);
  }
  return s;
}

Tensor curves_tensor(const std::vector<AttackCurvePoint>& curves) {
  Tensor t = at::empty({static_cast<int64_t>(curves.size()), kCurveColumns}, at::kDouble);
  auto* p = t.mutable_data_ptr<double>();
  for (const AttackCurvePoint& c : curves) {
    for (const double x : {static_cast<double>(c.step), c.loss, c.objective, c.rgb, c.chamfer,
                           c.laplacian, c.edge, c.success}) {
      *p++ = x;
    }
  }
  return t;
}

std::vector<AttackCurvePoint> curves_from(const TensorFile& file) {
  const Tensor t = file.get("curves", {-1, kCurveColumns}, at::kDouble);
  std::vector<AttackCurvePoint> curves;
  const auto* p = t.const_data_ptr<double>();
  for (int64_t i = 0; i < t.size(0); ++i, p += kCurveColumns) {
    curves.push_back({static_cast<int64_t>(p[0]), p[1], p[2], p[3], p[4], p[5], p[6], p[7]});
  }
  return curves;
}

void save_state(const AttackState& s, const std::filesystem::path& path) {
  std::vector<std::pair<std::string, Tensor>> tensors = {{"offsets", s.offsets}};
  const auto all = s.appearance->parameters();
  for (size_t i = 0; i < all.size(); ++i)
    tensors.emplace_back("appearance." + std::to_string(i), all[i]);
  for (size_t i = 0; i < s.moment1.size(); ++i) {
    tensors.emplace_back("moment1." + std::to_string(i), s.moment1[i]);
    tensors.emplace_back("moment2." + std::to_string(i), s.moment2[i]);
  }
  for (size_t i = 0; i < s.velocity.size(); ++i) {
    tensors.emplace_back("velocity." + std::to_string(i), s.velocity[i]);
  }
  tensors.emplace_back("curves", curves_tensor(s.curves));
  tensors.emplace_back("counters", at::tensor({s.step, int64_t{s.recovery.rollbacks}}, at::kLong));
  tensors.emplace_back("rate_scale", at::tensor({s.recovery.rate_scale}, at::kDouble));
  save_tensors(path, tensors, {{"format", "tt3d attack state"}});
}

void load_state(const std::filesystem::path& path, AttackState& s) {
  const TensorFile file = load_tensors(path);
  at::NoGradGuard guard;
  s.offsets.copy_(file.get("offsets", s.offsets.sizes(), at::kFloat));
  const auto all = s.appearance->parameters();
  for (size_t i = 0; i < all.size(); ++i) {
    all[i].copy_(file.get("appearance." + std::to_string(i), all[i].sizes(), at::kFloat));
  }
  for (size_t i = 0; i < s.moment1.size(); ++i) {
    const std::string n = std::to_string(i);
    s.moment1[i].copy_(file.get("moment1." + n, s.moment1[i].sizes(), at::kFloat));
    s.moment2[i].copy_(file.get("moment2." + n, s.moment2[i].sizes(), at::kFloat));
  }
  for (size_t i = 0; i < s.velocity.size(); ++i) {
    s.velocity[i].copy_(
        file.get("velocity." + std::to_string(i), s.velocity[i].sizes(), at::kFloat));
  }
  s.curves = curves_from(file);
  const Tensor counters = file.get("counters", {2}, at::kLong);
  s.step = counters[0].item<int64_t>();
  s.recovery.rollbacks = counters[1].item<int>();
  s.recovery.rate_scale = file.get("rate_scale", {1}, at::kDouble).item<double>();
}

}  // namespace tt3d
