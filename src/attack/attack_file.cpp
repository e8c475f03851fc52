#include <cstdio>

#include "attack_state.h"

namespace tt3d {

std::string curves_csv(const std::vector<AttackCurvePoint>& curves) {
  std::string text = "step,loss,objective,rgb,chamfer,laplacian,edge,success\n";
  char line[256];
  for (const AttackCurvePoint& c : curves) {
    std::snprintf(line, sizeof line, "%lld,%.6g,%.6g,%.6g,%.6g,%.6g,%.6g,%.4f\n",
                  static_cast<long long>(c.step), c.loss, c.objective, c.rgb, c.chamfer,
                  c.laplacian, c.edge, c.success);
    text += line;
  }
  return text;
}

std::string epochs_csv(const std::vector<AttackEpoch>& epochs) {
  std::string text = "step,objective,success,held_out\n";
  char line[128];
  for (const AttackEpoch& e : epochs) {
    std::snprintf(line, sizeof line, "%lld,%.6g,%.4f,%.4f\n", static_cast<long long>(e.step),
                  e.objective, e.success, e.held_out);
    text += line;
  }
  return text;
}

void save_attack(const AttackResult& r, const std::filesystem::path& path) {
  std::vector<std::pair<std::string, at::Tensor>> tensors = {
      {"vertices", r.mesh.vertices}, {"faces", r.mesh.faces}, {"curves", curves_tensor(r.curves)}};
  for (const auto& named : r.appearance->tensors()) tensors.push_back(named);
  save_tensors(path, tensors, {{"format", "tt3d attack"}});
}

AttackResult load_attack(const std::filesystem::path& path) {
  const TensorFile file = load_tensors(path);
  AttackResult r;
  r.mesh = {file.get("vertices", {-1, 3}, at::kFloat), file.get("faces", {-1, 3}, at::kInt)};
  r.appearance = read_appearance(file, r.mesh.faces);
  r.curves = curves_from(file);
  return r;
}

}  // namespace tt3d
