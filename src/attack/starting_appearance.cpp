#include <ATen/ATen.h>

#include <algorithm>

#include "starting_appearance.h"
#include "sticker.h"
#include "tt3d/appearance.h"
#include "tt3d/image.h"
#include "tt3d/surface.h"

namespace tt3d::attack {
namespace {

using at::Tensor;

const scene::UvMap& map_of(const AttackInput& input) {
  if (input.object.map) return *input.object.map;
  throw InputError(
      "attack.optimize: parts texture and tile need a UV map, and this object has "
      "none");
}

std::unique_ptr<object::Appearance> starting_texture(const AttackInput& input) {
  const scene::UvMap& map = map_of(input);
  return std::make_unique<object::TextureAppearance>(input.texels.to(at::kFloat) / 255, map,
                                                     object::Part::kTexture);
}

/// A tile covers the whole surface, so it starts at the mean colour of the clean object.
std::unique_ptr<object::Appearance> starting_tile(const AttackInput& input,
                                                  const AttackOptions& options) {
  const auto& [vertices, faces] = input.object.mesh;
  const auto colors =
      object::VertexColorAppearance::sample(*input.object.appearance, input.object.mesh);
  const Tensor tile = colors->parameters()[0]
                          .mean(0)
                          .expand({options.tile.tile_size, options.tile.tile_size, 3})
                          .contiguous();
  if (options.tile.mapping == TileMapping::kTriplanar) {
    return std::make_unique<object::TriplanarAppearance>(
        tile, scene::vertex_normals(vertices, faces), faces, options.tile.repeats);
  }
  const scene::UvMap& map = map_of(input);
  return std::make_unique<object::TextureAppearance>(
      tile, scene::UvMap{map.uvs * options.tile.repeats, map.faces}, object::Part::kTile);
}

std::unique_ptr<object::Appearance> unmasked_appearance(const AttackInput& input,
                                                        const AttackOptions& options) {
  using object::Part;
  const auto& [vertices, faces] = input.object.mesh;
  const auto& clean = input.object.appearance;
  if (options.optimizes(Part::kTexture)) return starting_texture(input);
  if (options.optimizes(Part::kTile)) return starting_tile(input, options);
  if (options.optimizes(Part::kVertexColors)) {
    return object::VertexColorAppearance::sample(*clean, input.object.mesh);
  }
  if (options.optimizes(Part::kMaterial) || options.optimizes(Part::kNormals) ||
      options.optimizes(Part::kLights)) {
    return object::ShadedAppearance::evenly_lit(clean, scene::vertex_normals(vertices, faces),
                                                faces);
  }
  return clean->clone();
}

/// Faces with free colours, [F] bool; undefined: all. A mask file takes precedence over a round
/// patch.
Tensor free_faces(const AttackInput& input, const AttackOptions& options) {
  if (!options.sticker.mask.empty()) {
    Tensor inside = masked_faces(map_of(input), image::read_image(options.sticker.mask));
    if (inside.any().item<bool>()) return inside;
    throw InputError(options.sticker.mask,
                     "has no light texel on the surface; paint the free area "
                     "white on a black copy of asset/clean.png");
  }
  if (options.sticker.area == 0) return {};
  return sticker_faces(input.object.mesh, options.sticker.area, options.sticker.azimuth_deg,
                       options.sticker.elevation_deg);
}

/// Throws InputError if attack.optimize names a part that this appearance does not have.
void check_parts(const AttackOptions& options, const object::Appearance& appearance) {
  std::vector<object::Part> parts = {object::Part::kVertices};
  for (const object::ParameterGroup& g : appearance.groups()) parts.push_back(g.part);
  if (options.optimize.empty()) throw InputError("attack.optimize: name at least one part");
  const auto missing =
      std::find_if(options.optimize.begin(), options.optimize.end(), [&](object::Part part) {
        return std::find(parts.begin(), parts.end(), part) == parts.end();
      });
  if (missing == options.optimize.end()) return;
  std::string has;
  for (const object::Part p : parts) has.append(has.empty() ? "" : ", ").append(name_of(p));
  throw InputError("attack.optimize: '" + name_of(*missing) +
                   "' cannot be combined with the other parts; this appearance has " + has);
}

}  // namespace

bool AttackOptions::optimizes(object::Part part) const {
  return std::find(optimize.begin(), optimize.end(), part) != optimize.end();
}

bool needs_grid_mlp(const AttackOptions& options) {
  return options.optimizes(object::Part::kGrid) || options.optimizes(object::Part::kMlp);
}

bool needs_uv_map(const AttackOptions& options) {
  const bool tiles =
      options.optimizes(object::Part::kTile) && options.tile.mapping == TileMapping::kAtlas;
  return tiles || options.optimizes(object::Part::kTexture) || !options.sticker.mask.empty();
}

std::unique_ptr<object::Appearance> starting_appearance(const AttackInput& input,
                                                        const AttackOptions& options) {
  auto appearance = unmasked_appearance(input, options);
  check_parts(options, *appearance);
  const Tensor inside = free_faces(input, options);
  if (!inside.defined()) return appearance;
  return std::make_unique<object::MaskedAppearance>(std::move(appearance), input.object.appearance,
                                                    inside);
}

}  // namespace tt3d::attack
