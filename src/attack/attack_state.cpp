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

std::vector<Tensor> object_tensors(const AttackState& s) {
  std::vector<Tensor> all = {s.offsets};
  for (const Tensor& t : s.appearance->parameters()) all.push_back(t);
  return all;
}

namespace {

using NamedTensors = std::vector<std::pair<std::string, Tensor>>;

std::string numbered(const std::string& name, size_t i) { return name + "." + std::to_string(i); }

void add_numbered(NamedTensors& named, const std::string& name, const std::vector<Tensor>& all) {
  for (size_t i = 0; i < all.size(); ++i) named.emplace_back(numbered(name, i), all[i]);
}

/// Reads into tensors that have their shapes already.
void copy_numbered(const TensorFile& file, const std::string& name,
                   const std::vector<Tensor>& all) {
  for (size_t i = 0; i < all.size(); ++i) {
    all[i].copy_(file.get(numbered(name, i), all[i].sizes(), at::kFloat));
  }
}

constexpr int64_t kEpochColumns = 4;

void save_epochs(const AttackState& s, NamedTensors& named) {
  std::vector<double> rows;
  for (const AttackEpoch& e : s.epochs) {
    rows.insert(rows.end(), {static_cast<double>(e.step), e.objective, e.success, e.held_out});
  }
  named.emplace_back("epochs", at::tensor(rows, at::kDouble).view({-1, kEpochColumns}));
  add_numbered(named, "best", s.best.tensors);
  named.emplace_back("best_figures",
                     at::tensor({s.best.success, static_cast<double>(s.best.age)}, at::kDouble));
}

void load_epochs(const TensorFile& file, AttackState& s) {
  const Tensor rows = file.get("epochs", {-1, kEpochColumns}, at::kDouble);
  const auto* p = rows.const_data_ptr<double>();
  s.epochs.clear();
  for (int64_t i = 0; i < rows.size(0); ++i, p += kEpochColumns) {
    s.epochs.push_back({static_cast<int64_t>(p[0]), p[1], p[2], p[3]});
  }
  s.best.tensors.clear();
  for (const Tensor& t : object_tensors(s)) s.best.tensors.push_back(at::empty_like(t.detach()));
  copy_numbered(file, "best", s.best.tensors);
  const Tensor figures = file.get("best_figures", {2}, at::kDouble);
  s.best.success = figures[0].item<double>();
  s.best.age = figures[1].item<int64_t>();
}

}  // namespace

void save_state(const AttackState& s, const std::filesystem::path& path) {
  NamedTensors tensors = {{"offsets", s.offsets}};
  add_numbered(tensors, "appearance", s.appearance->parameters());
  add_numbered(tensors, "moment1", s.moment1);
  add_numbered(tensors, "moment2", s.moment2);
  add_numbered(tensors, "velocity", s.velocity);
  tensors.emplace_back("curves", curves_tensor(s.curves));
  tensors.emplace_back("counters", at::tensor({s.step, int64_t{s.recovery.rollbacks}}, at::kLong));
  tensors.emplace_back("rate_scale", at::tensor({s.recovery.rate_scale}, at::kDouble));
  if (!s.epochs.empty()) save_epochs(s, tensors);
  save_tensors(path, tensors, {{"format", "tt3d attack state"}});
}

void load_state(const std::filesystem::path& path, AttackState& s) {
  const TensorFile file = load_tensors(path);
  at::NoGradGuard guard;
  s.offsets.copy_(file.get("offsets", s.offsets.sizes(), at::kFloat));
  copy_numbered(file, "appearance", s.appearance->parameters());
  copy_numbered(file, "moment1", s.moment1);
  copy_numbered(file, "moment2", s.moment2);
  copy_numbered(file, "velocity", s.velocity);
  s.curves = curves_from(file);
  const Tensor counters = file.get("counters", {2}, at::kLong);
  s.step = counters[0].item<int64_t>();
  s.recovery.rollbacks = counters[1].item<int>();
  s.recovery.rate_scale = file.get("rate_scale", {1}, at::kDouble).item<double>();
  if (file.tensors.contains("epochs")) load_epochs(file, s);
}

}  // namespace tt3d
