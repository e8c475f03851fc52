#pragma once

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "tt3d/appearance.h"
#include "tt3d/raster.h"

/// Storage of appearances, which can be nested. Private to this room.
namespace tt3d::object {

/// Adds an appearance's tensors under names that begin with `prefix`.
void append_prefixed(std::vector<std::pair<std::string, at::Tensor>>& named,
                     const std::string& prefix, const Appearance& appearance);
/// The tensors of the file whose names begin with `prefix`, without the prefix.
[[nodiscard]] TensorFile without_prefix(const TensorFile& file, const std::string& prefix);

/// The appearance in the file, or null if the file has none of this kind.
[[nodiscard]] std::unique_ptr<Appearance> read_textured(const TensorFile& file,
                                                        const at::Tensor& faces);
[[nodiscard]] std::unique_ptr<Appearance> read_shaded(const TensorFile& file,
                                                      const at::Tensor& faces);

}  // namespace tt3d::object
