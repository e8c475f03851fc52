#pragma once

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "tt3d/appearance.h"

/// How looks are stored, one inside another: shared by their sources.
namespace tt3d {

/// Adds a look's tensors under names that begin with `prefix`.
void append_prefixed(std::vector<std::pair<std::string, at::Tensor>>& named,
                     const std::string& prefix, const Appearance& look);
/// Those of the file's tensors, under their own names.
[[nodiscard]] TensorFile without_prefix(const TensorFile& file, const std::string& prefix);

/// The look that the file holds, or null where it holds none of that kind.
[[nodiscard]] std::unique_ptr<Appearance> read_textured(const TensorFile& file,
                                                        const at::Tensor& faces);
[[nodiscard]] std::unique_ptr<Appearance> read_shaded(const TensorFile& file,
                                                      const at::Tensor& faces);

/// Values [V,C] at a mesh's vertices, blended at surface points: [C,P].
[[nodiscard]] at::Tensor at_points(const at::Tensor& values, const SurfacePoints& points,
                                   const at::Tensor& faces);

}  // namespace tt3d
