#include "config_schema.h"

namespace tt3d::config {

Schema::Schema(RunConfig& c) {
  integer("seed", c.seed, 0, 1e15, "", "seed of every random stream");
  capture_keys(c);
  field_keys(c);
  mesh_keys(c);
  attack_keys(c);
  eot_keys(c);
  bake_and_evaluate_keys(c);
}

void Schema::capture_keys(RunConfig& c) {
  path("asset.path", c.asset, "textured mesh (GLB, OBJ) that is attacked in place of a capture");
  path("capture.path", c.capture.path, "folder of the photographs and their cameras");
  text("capture.format", c.capture.format, {"auto", "nerf-synthetic", "nerfstudio", "colmap"},
       "file format of the cameras");
  integer("capture.max_size", c.capture.max_size, 0, 16384, "pixels",
          "photographs are reduced to this longer side; 0 keeps them");
  integer("capture.max_train_views", c.capture.max_train_views, 0, 1e6, "",
          "evenly spaced subset of the training views; 0 takes all");
  integer("capture.max_test_views", c.capture.max_test_views, 0, 1e6, "",
          "evenly spaced subset of the test views; 0 takes all");
}

void Schema::field_keys(RunConfig& c) {
  FieldOptions& f = c.field;
  for (auto* grid : {&f.shape.geometry, &f.shape.appearance}) {
    const std::string name = grid == &f.shape.geometry ? "field.geometry." : "field.appearance.";
    integer(name + "levels", grid->levels, 1, 32, "", "levels of the hash grid");
    integer(name + "base", grid->base, 2, 512, "cells", "resolution of its coarsest level");
    integer(name + "finest", grid->finest, 2, 65536, "cells", "resolution of its finest level");
    integer(name + "log2_size", grid->log2_size, 8, 24, "", "log2 of the entries a level at most");
  }
  integer("field.occupancy", f.shape.occupancy, 16, 512, "cells",
          "side of the occupancy grid, a multiple of 8");
  integer("field.steps", f.steps, 1, 1e7, "", "training steps");
  integer("field.samples_per_step", f.samples_per_step, 1024, 1 << 24, "", "samples a step takes");
  integer("field.ray_steps", f.ray_steps, 16, 8192, "", "steps across the box's diagonal");
  number("field.rate", f.rate, 1e-7, 1, "", "Adam's learning rate at its peak");
  integer("field.warmup", f.warmup, 0, 1e6, "steps",
          "linear warm-up, at most a tenth of all steps");
  number("field.diffuse_share", f.diffuse_share, 0, 1, "",
         "share of the steps with diffuse colour only");
  number("field.mask_weight", f.mask_weight, 0, 1e6, "", "weight of the mask loss");
  number("field.specular_weight", f.specular_weight, 0, 1e6, "",
         "weight of the specular part's square");
  number("field.tv_weight", f.tv_weight, 0, 1e6, "", "weight of total variation on the grids");
  integer("field.checkpoint_every", f.checkpoint_every, 1, 1e7, "steps",
          "steps between checkpoints");
}

void Schema::mesh_keys(RunConfig& c) {
  MeshOptions& m = c.mesh;
  integer("mesh.resolution", m.resolution, 16, 1024, "points", "side of the marching-cubes grid");
  number("mesh.iso", m.iso, 1e-3, 1e6, "", "density of the surface, at most the field's mean");
  integer("mesh.close_gaps", m.close_gaps, 0, 16, "points",
          "cavities and tunnels too narrow for a cube of 2 n + 1 grid points are filled");
  number("mesh.min_component", m.min_component, 0, 1, "",
         "components below this share of the diameter go");
  integer("mesh.target_faces", m.target_faces, 100, 5e6, "faces", "faces after simplification");
  integer("mesh.min_faces", m.min_faces, 0, 5e6, "faces", "refinement does not thin below this");
  integer("mesh.max_faces", m.max_faces, 100, 1e7, "faces",
          "refinement does not split beyond this");
  integer("mesh.refine_steps", m.refine_steps, 0, 1e6, "", "refinement steps");
  integer("mesh.views_per_step", m.views_per_step, 1, 64, "", "photographs a refinement step");
  number("mesh.vertex_rate", m.vertex_rate, 0, 1, "", "learning rate of vertex offsets");
  number("mesh.appearance_rate", m.appearance_rate, 0, 1, "", "learning rate of the appearance");
  number("mesh.mask_weight", m.mask_weight, 0, 1e6, "", "weight of the mask loss");
  number("mesh.laplacian_weight", m.laplacian_weight, 0, 1e6, "",
         "weight of the uniform Laplacian");
  number("mesh.offset_weight", m.offset_weight, 0, 1e6, "", "weight of the offsets' square");
  shares("mesh.remesh_at", m.remesh_at, "shares of the steps at which faces are split and thinned");
  number("mesh.split_share", m.split_share, 0, 1, "",
         "share of faces, worst error first, that is split");
  number("mesh.decimate_share", m.decimate_share, 0, 1, "",
         "share of faces, best error first, that is thinned");
  number("mesh.decimate_ratio", m.decimate_ratio, 0.01, 1, "", "share of those that is kept");
  number("mesh.min_edge", m.min_edge, 0, 1, "object box / 2", "edges are not split below this");
  integer("mesh.checkpoint_every", m.checkpoint_every, 1, 1e7, "steps",
          "steps between checkpoints");
}

void Schema::attack_keys(RunConfig& c) {
  AttackOptions& a = c.attack;
  text(kMethod, c.attack_method, attack_preset_names(),
       "preset of the keys below ('tt3d attack --list')");
  texts("attack.optimize", a.optimize, attack_parts(), "parts of the object that may change");
  text("attack.target", c.attack_target, {},
       "target class: index, WordNet id or name; an untargeted attack needs none");
  texts("attack.surrogates", c.attack_surrogates, {}, "models the attack may see");
  texts("attack.also", c.attack_also, {},
        "run folders of further objects that shall wear the same tile: a universal attack");
  text("attack.objective", a.objective, objective_names(), "loss on the surrogates' logits");
  integer("attack.texture_size", a.texture_size, 8, 8192, "texels", "side of part texture");
  integer("attack.tile_size", a.tile_size, 4, 4096, "texels", "side of part tile");
  text("attack.tile_mapping", a.tile_mapping, tile_mapping_names(),
       "how the tile covers the surface: over the texture's charts, or along the three axes");
  number("attack.tile_repeats", a.tile_repeats, 0.1, 100, "",
         "tiles along the side of the atlas or of the object's box");
  number("attack.sticker_area", a.sticker_area, 0, 1, "",
         "share of the surface where colours are free, a round patch; 0: all of it");
  number("attack.sticker_azimuth_deg", a.sticker_azimuth_deg, -360, 360, "degrees",
         "side of the object that the patch sits on");
  number("attack.sticker_elevation_deg", a.sticker_elevation_deg, -90, 90, "degrees",
         "its height on the object");
  path(
      "attack.sticker_mask", a.sticker_mask,
      "picture over the texture's charts, as asset/clean.png lies there: colours are free where it "
      "is light; rules over the patch");
  text("attack.goal", a.goal, goal_names(), "towards the target, or away from the true class");
  text("attack.ensemble", a.ensemble, ensemble_names(), "what is averaged over the surrogates");
  number("attack.beta", a.beta, 0, 1e9, "", "strength of naturalness (paper: 1e3)");
  number("attack.rgb_weight", a.rgb_weight, 0, 1e9, "", "l1, weight of R_rgb");
  text("attack.color_space", a.color_space, color_space_names(),
       "where R_rgb measures: sRGB, or CIE L*a*b* in hundreds");
  number("attack.chamfer_weight", a.chamfer_weight, 0, 1e9, "", "l2, weight of R_cd");
  number("attack.laplacian_weight", a.laplacian_weight, 0, 1e9, "", "l3, weight of R_lap");
  number("attack.edge_weight", a.edge_weight, 0, 1e9, "", "l4, weight of R_edge");
  number("attack.psnr_floor", a.psnr_floor, 0, 99, "dB",
         "R_rgb counts only beyond the error of this PSNR; 0: always, as in the paper");
  number("attack.ssim_floor", a.ssim_floor, 0, 1, "",
         "what SSIM to the clean pictures lacks to this counts, too; 0: nothing");
  number("attack.ssim_weight", a.ssim_weight, 0, 1e9, "", "weight of what SSIM lacks");
  text("attack.laplacian", a.laplacian, laplacian_names(), "weights of a vertex's neighbours");
  number("attack.displacement_weight", a.displacement_weight, 0, 1e9, "",
         "weight of how much neighbours move apart (MeshAdv)");
  number("attack.variation_weight", a.variation_weight, 0, 1e9, "",
         "weight of the total variation of what was changed");
  number("attack.printability_weight", a.printability_weight, 0, 1e9, "",
         "weight of the distance to printable colours");
  path("attack.printer_colors", a.printer_colors,
       "file of the printable colours, three numbers from 0 to 1 a line; empty: mixes of process "
       "inks");
  number("attack.max_displacement", a.max_displacement, 0, 1, "object box / 2",
         "no vertex moves further; 0: no bound");
  integer("attack.steps", a.steps, 1, 1e7, "", "optimisation steps");
  integer("attack.views_per_step", a.views_per_step, 1, 256, "", "fresh views a step");
  integer("attack.image_size", a.image_size, 16, 4096, "pixels", "side of the rendered pictures");
  text("attack.view_distribution", a.view_distribution, view_distribution_names(),
       "where views are drawn from");
  number("attack.appearance_rate", a.appearance_rate, 0, 1, "", "learning rate of the look");
  number("attack.vertex_rate", a.vertex_rate, 0, 1, "", "learning rate of vertex offsets");
  number("attack.final_rate", a.final_rate, 1e-4, 1, "", "share of the rates left at the end");
  text("attack.schedule", a.schedule, schedule_names(), "the rates' way there");
  number("attack.momentum", a.momentum, 0, 1, "",
         "share of past gradients in each direction, beside Adam's; 0: none");
  number(
      "attack.feature_mix", a.feature_mix, 0, 1, "",
      "share of the surrogates' layers that see some of the clean object's features, too; 0: none");
  number("attack.feature_mix_share", a.feature_mix_share, 0, 1, "",
         "largest share of the clean features in a channel");
  integer("attack.epoch", a.epoch, 0, 1e7, "steps",
          "steps after which held-out views are scored and the best state is kept; 0: never");
  integer("attack.held_out_views", a.held_out_views, 1, 1e5, "", "views that are scored");
  integer("attack.patience", a.patience, 0, 1e6, "epochs",
          "stops after that many without a higher success; 0: never");
  integer("attack.checkpoint_every", a.checkpoint_every, 1, 1e7, "steps",
          "steps between checkpoints");
}

void Schema::eot_keys(RunConfig& c) {
  EotOptions& e = c.attack.eot;
  number("attack.eot.object_shift", e.object_shift, 0, 1, "object radii",
         "shift of the object along each axis, each way; 0 switches it off, as in all below");
  number("attack.eot.light", e.light, 0, 0.75, "",
         "largest share of the light that comes from one random direction");
  number("attack.eot.scale_low", e.scale_low, 0.05, 4, "",
         "smallest size of the picture in the frame");
  number("attack.eot.scale_high", e.scale_high, 0.05, 4, "",
         "largest size of the picture in the frame");
  number("attack.eot.shift", e.shift, 0, 1, "frame sides", "place in the frame, each way");
  number("attack.eot.rotation_deg", e.rotation_deg, 0, 180, "degrees",
         "in-plane rotation, each way");
  number("attack.eot.brightness", e.brightness, 0, 1, "", "factor 1 - b to 1 + b");
  number("attack.eot.contrast", e.contrast, 0, 1, "", "factor 1 - c to 1 + c");
  number("attack.eot.saturation", e.saturation, 0, 1, "", "factor 1 - s to 1 + s");
  number("attack.eot.blur", e.blur, 0, 10, "pixels", "largest sigma of Gaussian blur");
  number("attack.eot.resolution", e.resolution, 0.05, 1, "",
         "pictures go down to this share of the pixels a side, or less far, and up again; 1: off");
  number("attack.eot.noise", e.noise, 0, 1, "", "largest sigma of Gaussian noise");
  number("attack.eot.jpeg", e.jpeg, 0, 1, "", "share of pictures that pass through JPEG");
  integer("attack.eot.jpeg_quality_low", e.jpeg_quality_low, 1, 100, "", "worst quality of these");
  integer("attack.eot.jpeg_quality_high", e.jpeg_quality_high, 1, 100, "", "best quality of these");
  number("attack.eot.mix", e.mix, 0, 1, "", "share of a photograph that is added to each picture");
  number("attack.eot.diversity", e.diversity, 0, 1, "",
         "share of pictures that are shrunk and padded with black");
  number("attack.eot.diversity_low", e.diversity_low, 0.1, 1, "", "smallest size of these");
  number("attack.eot.plain_background", e.plain_background, 0, 1, "",
         "share of pictures on a random plain colour");
  number("attack.eot.photograph_background", e.photograph_background, 0, 1, "",
         "share of pictures on a photograph; the rest on white");
  path("attack.eot.photographs", e.photographs,
       "folder of the photographs for backgrounds and mix");
}

void Schema::bake_and_evaluate_keys(RunConfig& c) {
  integer("bake.resolution", c.bake_resolution, 64, 16384, "texels", "side of the texture");
  integer("bake.padding", c.bake_padding, 0, 64, "texels", "space between charts");
  number("bake.unwrap_time_limit", c.unwrap_time_limit, 1, 1e5, "seconds",
         "time limit of the unwrap");
  text("evaluate.true_class", c.true_class, {},
       "class of the object, what an untargeted attack leads away from; empty: no accuracy "
       "figures");
  texts("evaluate.victims", c.victims, {}, "models that are scored");
  integer("evaluate.views", c.evaluate_views, 1, 1e6, "", "held-out random views");
  text("evaluate.view_distribution", c.evaluate_distribution, view_distribution_names(),
       "where views are drawn from");
  integer("evaluate.size", c.evaluate_size, 16, 8192, "pixels", "side of the pictures");
  text("evaluate.background", c.evaluate_background, {},
       "white, #rrggbb or a folder of photographs");
  integer("evaluate.samples", c.evaluate_samples, 1, 64, "rays",
          "a pixel, a square number: more are averaged as a camera does");
  integer("evaluate.geometry", c.evaluate_geometry, 0, 1, "",
          "1: also compare shapes with the clean object (needs scripts/setup --all)");
}

}  // namespace tt3d::config
