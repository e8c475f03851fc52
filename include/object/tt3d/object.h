#pragma once

#include <ATen/core/Tensor.h>

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "tt3d/appearance.h"
#include "tt3d/surface.h"

/// The object: stage `mesh` creates it, `attack` changes it, and `bake` writes it as an asset.
namespace tt3d::object {

/// A shape in the normalised frame with its appearance.
struct Object {
  scene::TriMesh mesh;
  std::shared_ptr<const Appearance> appearance;
  /// The UV map of the surface, if known.
  std::optional<scene::UvMap> map;
  /// A copy on a device, without gradient; shares memory if it is already there.
  [[nodiscard]] Object to(at::Device device) const;
};

/// Writes mesh and appearance as safetensors, atomically; the map is not part of the file. `more`:
/// further tensors of the file. `format`: names the kind of file. Throws ResourceError.
void save_object(const Object& object, const std::filesystem::path& path,
                 const std::vector<std::pair<std::string, at::Tensor>>& more = {},
                 const std::string& format = "tt3d object");
/// Reads such a file, from stage mesh or attack. Throws InputError.
[[nodiscard]] Object load_object(const std::filesystem::path& path);

/// Writes and reads a UV map of a surface with `faces` faces, as safetensors. `cut`: a key of the
/// options and mesh that the map was made with. load_map returns nothing if the file is absent or
/// has another `cut`. Throws ResourceError and InputError.
void save_map(const scene::UvMap& map, const std::vector<int64_t>& cut,
              const std::filesystem::path& path);
[[nodiscard]] std::optional<scene::UvMap> load_map(const std::filesystem::path& path, int64_t faces,
                                                   const std::vector<int64_t>& cut);

}  // namespace tt3d::object
