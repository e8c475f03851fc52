#include <ATen/ATen.h>

#include <algorithm>

#include "attack_state.h"
#include "sticker.h"

namespace tt3d {
namespace {

using at::Tensor;

const TextureMap& map_of(const AttackInput& input) {
  if (input.map.uvs.defined()) return input.map;
  throw InputError(
      "attack.optimize: texture and tile need a map of the surface, this object has "
      "none");
}

std::unique_ptr<Appearance> starting_texture(const AttackInput& input) {
  const TextureMap& map = map_of(input);
  return std::make_unique<TextureAppearance>(input.texels.to(at::kFloat) / 255, map, "texture");
}

/// A tile paints the whole surface, so it starts from the clean object's mean colour.
std::unique_ptr<Appearance> starting_tile(const AttackInput& input, const AttackOptions& options) {
  const auto& [vertices, faces] = input.mesh;
  const auto colors = VertexColorAppearance::sample(*input.appearance, input.mesh);
  const Tensor tile = colors->parameters()[0]
                          .mean(0)
                          .expand({options.tile_size, options.tile_size, 3})
                          .contiguous();
  if (options.tile_mapping == "triplanar") {
    return std::make_unique<TriplanarAppearance>(tile, vertex_normals(vertices, faces), faces,
                                                 options.tile_repeats);
  }
  if (options.tile_mapping != "atlas") {
    throw InputError("attack.tile_mapping: unknown '" + options.tile_mapping +
                     "', expected atlas or triplanar");
  }
  const TextureMap& map = map_of(input);
  return std::make_unique<TextureAppearance>(
      tile, TextureMap{map.uvs * options.tile_repeats, map.uv_faces}, "tile");
}

std::unique_ptr<Appearance> unmasked_look(const AttackInput& input, const AttackOptions& options) {
  const auto any = [&](std::initializer_list<const char*> parts) {
    return std::any_of(parts.begin(), parts.end(),
                       [&](const char* part) { return optimizes(options, part); });
  };
  if (any({"texture"})) return starting_texture(input);
  if (any({"tile"})) return starting_tile(input, options);
  if (any({"vertex-colors"})) return VertexColorAppearance::sample(*input.appearance, input.mesh);
  if (any({"material", "normals", "lights"})) {
    const auto& [vertices, faces] = input.mesh;
    return ShadedAppearance::evenly_lit(input.appearance, vertex_normals(vertices, faces), faces);
  }
  return input.appearance->clone();
}

/// Faces whose colours may change, [F] bool; undefined: all. A drawn mask rules over a round patch.
Tensor free_faces(const AttackInput& input, const AttackOptions& options) {
  if (!options.sticker_mask.empty()) {
    const Tensor inside = masked_faces(map_of(input), read_image(options.sticker_mask));
    if (inside.any().item<bool>()) return inside;
    throw InputError(options.sticker_mask,
                     "is light nowhere on the surface; paint what may change "
                     "white on a black copy of asset/clean.png");
  }
  if (options.sticker_area == 0) return {};
  return sticker_faces(input.mesh, options.sticker_area, options.sticker_azimuth_deg,
                       options.sticker_elevation_deg);
}

void check_parts(const AttackOptions& options, const Appearance& look) {
  std::vector<std::string> parts = {"vertices"};
  for (const ParameterGroup& g : look.groups()) parts.push_back(g.name);
  if (options.optimize.empty()) throw InputError("attack.optimize: name at least one part");
  for (const std::string& part : options.optimize) {
    if (std::find(parts.begin(), parts.end(), part) != parts.end()) continue;
    std::string has;
    for (const std::string& p : parts) has += (has.empty() ? "" : ", ") + p;
    throw InputError("attack.optimize: '" + part + "' does not go together with this look: " + has);
  }
}

}  // namespace

const std::vector<std::string>& tile_mapping_names() {
  static const std::vector<std::string> names = {"atlas", "triplanar"};
  return names;
}

bool needs_grid_mlp(const AttackOptions& options) {
  return optimizes(options, "grid") || optimizes(options, "mlp");
}

bool needs_texture_map(const AttackOptions& options) {
  const bool tiles = optimizes(options, "tile") && options.tile_mapping == "atlas";
  return tiles || optimizes(options, "texture") || !options.sticker_mask.empty();
}

std::unique_ptr<Appearance> starting_look(const AttackInput& input, const AttackOptions& options) {
  auto look = unmasked_look(input, options);
  check_parts(options, *look);
  const Tensor inside = free_faces(input, options);
  if (!inside.defined()) return look;
  return std::make_unique<MaskedAppearance>(std::move(look), input.appearance, inside);
}

}  // namespace tt3d
