// The effect of each transform of an attack on an asset's picture. For each transform alone, with a
// wide range, it writes a strip of five draws to DIR/NAME.png. bench/transforms.py puts the strips
// on one sheet.
//
//   show_transforms ASSET.glb DIR [PHOTOGRAPHS]
#include <ATen/ATen.h>

#include <cstdio>
#include <functional>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "tt3d/appearance.h"
#include "tt3d/eot.h"
#include "tt3d/error.h"
#include "tt3d/evaluate.h"
#include "tt3d/image.h"
#include "tt3d/mesh.h"

namespace {

using at::Tensor;
using tt3d::attack::EotOptions;

constexpr int64_t kDraws = 5, kSize = 160;

EotOptions nothing() {
  EotOptions o;
  o.scale_low = o.scale_high = 1;
  o.shift = o.rotation_deg = o.brightness = o.contrast = o.saturation = o.blur = o.noise = 0;
  o.plain_background = 0;
  return o;
}

/// Each transform by its key, with the options that enable it.
std::vector<std::pair<std::string, std::function<void(EotOptions&)>>> transforms(bool photographs) {
  std::vector<std::pair<std::string, std::function<void(EotOptions&)>>> all = {
      {"none", [](EotOptions&) {}},
      {"object_shift", [](EotOptions& o) { o.object_shift = 0.3; }},
      {"light", [](EotOptions& o) { o.light = 0.6; }},
      {"scale", [](EotOptions& o) { o.scale_low = 0.5, o.scale_high = 1.3; }},
      {"shift", [](EotOptions& o) { o.shift = 0.2; }},
      {"rotation_deg", [](EotOptions& o) { o.rotation_deg = 60; }},
      {"plain_background", [](EotOptions& o) { o.plain_background = 1; }},
      {"brightness", [](EotOptions& o) { o.brightness = 0.6; }},
      {"contrast", [](EotOptions& o) { o.contrast = 0.7; }},
      {"saturation", [](EotOptions& o) { o.saturation = 1; }},
      {"blur", [](EotOptions& o) { o.blur = 4; }},
      {"resolution", [](EotOptions& o) { o.resolution = 0.1; }},
      {"noise", [](EotOptions& o) { o.noise = 0.2; }},
      {"jpeg", [](EotOptions& o) { o.jpeg = 1, o.jpeg_quality_low = 2, o.jpeg_quality_high = 30; }},
      {"diversity", [](EotOptions& o) { o.diversity = 1, o.diversity_low = 0.5; }}};
  if (!photographs) return all;
  all.emplace_back("photograph_background", [](EotOptions& o) { o.photograph_background = 1; });
  all.emplace_back("mix", [](EotOptions& o) { o.mix = 0.4; });
  return all;
}

/// One view of the object with a transform, one draw per picture: [3,S,N S].
Tensor strip(const tt3d::asset::TexturedMesh& asset, const tt3d::scene::ViewFrame& frame,
             const EotOptions& o, const tt3d::scene::Backgrounds* photographs) {
  const tt3d::object::TextureAppearance appearance(asset.texture.to(at::kFloat) / 255, asset.map,
                                                   tt3d::object::Part::kTexture);
  const tt3d::mesh::RenderMesh mesh(asset.faces);
  const Tensor normals = tt3d::scene::vertex_normals(asset.vertices, asset.faces);
  const auto side = tt3d::scene::sample_views(tt3d::scene::ViewDistribution::kRing, /*seed=*/0, 0,
                                              1, kSize, frame)[0]
                        .camera;
  std::vector<Tensor> pictures;
  for (int64_t draw = 0; draw < kDraws; ++draw) {
    const auto cameras = tt3d::attack::shift_object({side}, frame.radius, o, /*seed=*/1, draw);
    const Tensor shown =
        tt3d::mesh::render_mesh(asset.vertices, asset.vertices, mesh, cameras,
                                [&](const tt3d::raster::SurfacePoints& p) {
                                  const Tensor normal = tt3d::raster::interpolate(
                                      normals, p.rast.view({1, 1, -1, 4}), asset.faces);
                                  return at::cat({appearance.color(p), normal.view({-1, 3}).t()});
                                })
            .permute({0, 3, 1, 2});
    const Tensor rgba = at::cat({shown.narrow(1, 0, 3), shown.narrow(1, 6, 1)}, 1);
    const Tensor lit = tt3d::attack::light_pictures(rgba, shown.narrow(1, 3, 3), o, 1, draw);
    pictures.push_back(tt3d::attack::transform_images(lit, kSize, o, 1, draw, photographs)[0]);
  }
  return at::cat(pictures, 2);
}

void show(const std::filesystem::path& path, const std::filesystem::path& folder,
          const std::string& photographs) {
  const tt3d::asset::TexturedMesh asset = tt3d::asset::load_asset(path);
  const tt3d::scene::ViewFrame frame = tt3d::asset::view_frame(asset, path);
  std::optional<tt3d::scene::Backgrounds> behind;
  if (!photographs.empty()) behind.emplace(photographs);
  for (const auto& [name, switch_on] : transforms(behind.has_value())) {
    EotOptions o = nothing();
    switch_on(o);
    const Tensor row = strip(asset, frame, o, behind ? &*behind : nullptr).permute({1, 2, 0});
    tt3d::write_file_atomic(folder / (name + ".png"),
                            tt3d::image::encode_png(tt3d::image::to_uint8(row)));
  }
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 3 || argc > 4) {
    std::fprintf(stderr, "usage: show_transforms ASSET.glb DIR [PHOTOGRAPHS]\n");
    return 2;
  }
  try {
    show(argv[1], argv[2], argc == 4 ? argv[3] : "");
  } catch (const tt3d::Error& error) {
    std::fprintf(stderr, "show_transforms: %s\n", error.what());
    return error.exit_code();
  }
}
