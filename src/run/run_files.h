#pragma once

#include "tt3d/asset.h"
#include "tt3d/scene.h"

/// Files of a run folder that several stages use.
namespace tt3d::run {

/// State of an interrupted stage, in the folder of the stage.
inline constexpr const char* kCheckpoint = "checkpoint.safetensors";

/// The origin of the assets of an object with this normalisation (see asset::far_origin).
[[nodiscard]] inline std::array<double, 3> origin_of(const scene::Normalization& n) {
  std::array<double, 3> low = n.centre, high = n.centre;
  for (size_t k = 0; k < 3; ++k) {
    low[k] -= 1 / n.scale;
    high[k] += 1 / n.scale;
  }
  return asset::far_origin(low, high);
}

/// The same normalisation for world coordinates from which `origin` is subtracted.
[[nodiscard]] inline scene::Normalization relative_to(const std::array<double, 3>& origin,
                                                      scene::Normalization n) {
  for (size_t k = 0; k < 3; ++k) n.centre[k] -= origin[k];
  return n;
}

}  // namespace tt3d::run
