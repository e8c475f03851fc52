#include <ATen/ATen.h>

#include "tt3d/object.h"
#include "tt3d/tensor_file.h"

namespace tt3d::object {
namespace fs = std::filesystem;

using at::Tensor;

Object Object::to(at::Device device) const {
  Object there = {mesh.to(device), appearance->to(device), {}};
  if (map) there.map = map->to(device);
  return there;
}

void save_object(const Object& object, const fs::path& path,
                 const std::vector<std::pair<std::string, Tensor>>& more,
                 const std::string& format) {
  std::vector<std::pair<std::string, Tensor>> tensors = {{"vertices", object.mesh.vertices},
                                                         {"faces", object.mesh.faces}};
  tensors.insert(tensors.end(), more.begin(), more.end());
  for (const auto& named : object.appearance->tensors()) tensors.push_back(named);
  save_tensors(path, tensors, {{"format", format}});
}

Object load_object(const fs::path& path) {
  const TensorFile file = load_tensors(path);
  Object object;
  object.mesh = {file.get("vertices", {-1, 3}, at::kFloat), file.get("faces", {-1, 3}, at::kInt)};
  object.appearance = read_appearance(file, object.mesh.faces);
  return object;
}

void save_map(const scene::UvMap& map, const std::vector<int64_t>& cut, const fs::path& path) {
  save_tensors(path,
               {{"uvs", map.uvs}, {"uv_faces", map.faces}, {"cut", at::tensor(cut, at::kLong)}},
               {{"format", "tt3d uv map"}});
}

std::optional<scene::UvMap> load_map(const fs::path& path, int64_t faces,
                                     const std::vector<int64_t>& cut) {
  if (!fs::exists(path)) return std::nullopt;
  const TensorFile file = load_tensors(path);
  if (!at::equal(file.get("cut", {-1}, at::kLong), at::tensor(cut, at::kLong))) return std::nullopt;
  return scene::UvMap{file.get("uvs", {-1, 2}, at::kFloat),
                      file.get("uv_faces", {faces, 3}, at::kInt)};
}

}  // namespace tt3d::object
