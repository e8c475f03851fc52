#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "tt3d/appearance.h"
#include "tt3d/eot.h"
#include "tt3d/keys.h"
#include "tt3d/mesh.h"
#include "tt3d/scene.h"

/// Options of an attack. The default values are those of the program; a preset (attack.method) is a
/// named set of other values.
namespace tt3d::attack {

// ---- Objective ----------------------------------------------------------------------------

/// The loss on a surrogate's logits.
enum class Objective {
  kCrossEntropy,
  kLogit,   ///< the negated logit of the class (Zhao et al. 2021)
  kMargin,  ///< log-sum-exp of the other logits minus the logit of the class (after Carlini &
            ///< Wagner 2017)
};
[[nodiscard]] constexpr std::array<std::string_view, 3> enum_names(Objective) {
  return {"cross-entropy", "logit", "margin"};
}

/// Towards the target class, or away from the true class.
enum class Goal { kTargeted, kUntargeted };
[[nodiscard]] constexpr std::array<std::string_view, 2> enum_names(Goal) {
  return {"targeted", "untargeted"};
}

/// How several surrogates are combined.
enum class EnsembleMode {
  kLosses,     ///< mean of the losses
  kLogits,     ///< loss of the mean logits (Dong et al. 2018)
  kGradients,  ///< mean of the gradients with respect to the rendered pictures, each scaled to
               ///< length 1
  kViews,      ///< each view is shown to one surrogate, in turn
};
[[nodiscard]] constexpr std::array<std::string_view, 4> enum_names(EnsembleMode) {
  return {"losses", "logits", "gradients", "views"};
}

struct ObjectiveOptions {
  Objective loss = Objective::kLogit;
  Goal goal = Goal::kTargeted;
  EnsembleMode ensemble = EnsembleMode::kLosses;
  double feature_mix = 0, feature_mix_share = 0.75;

  void keys(KeyList& key) {
    key("objective", loss, "loss on the surrogates' logits");
    key("goal", goal, "towards the target, or away from the true class");
    key("ensemble", ensemble, "how several surrogates are combined");
    key("feature_mix", feature_mix, {0, 1}, "",
        "probability that a layer of a surrogate mixes in features of the clean object in the same "
        "view (clean feature mixup; Byun et al., CVPR 2023); 0: never");
    key("feature_mix_share", feature_mix_share, {0, 1}, "",
        "largest share of the clean features in a channel");
  }
};

// ---- Naturalness --------------------------------------------------------------------------

/// The colour space of R_rgb.
enum class ColorSpace {
  kRgb,  ///< squared distance of sRGB colours
  kLab,  ///< squared distance of CIE L*a*b* colours, in hundreds
};
[[nodiscard]] constexpr std::array<std::string_view, 2> enum_names(ColorSpace) {
  return {"rgb", "lab"};
}

struct NaturalnessOptions {
  double beta = 1000;
  double rgb_weight = 1, chamfer_weight = 3000, laplacian_weight = 1e-3, edge_weight = 1e-2;
  ColorSpace color_space = ColorSpace::kRgb;
  mesh::LaplacianWeights laplacian = mesh::LaplacianWeights::kUniform;
  double psnr_floor = 21.5, ssim_floor = 0.82, ssim_weight = 0.05;
  double displacement_weight = 0, variation_weight = 0, printability_weight = 0;
  std::filesystem::path printer_colors;
  double max_displacement = 0;

  void keys(KeyList& key) {
    key("beta", beta, {0, 1e9}, "", "strength of naturalness (paper: 1e3)");
    key("rgb_weight", rgb_weight, {0, 1e9}, "", "l1, weight of R_rgb");
    key("color_space", color_space, "colour space of R_rgb: sRGB, or CIE L*a*b* in hundreds");
    key("chamfer_weight", chamfer_weight, {0, 1e9}, "", "l2, weight of R_cd");
    key("laplacian_weight", laplacian_weight, {0, 1e9}, "", "l3, weight of R_lap");
    key("edge_weight", edge_weight, {0, 1e9}, "", "l4, weight of R_edge");
    key("psnr_floor", psnr_floor, {0, 99}, "dB",
        "only an error above that of this PSNR counts in R_rgb; 0: every error, as in the paper");
    key("ssim_floor", ssim_floor, {0, 1}, "",
        "an SSIM to the clean pictures below this value is penalised; 0: never");
    key("ssim_weight", ssim_weight, {0, 1e9}, "",
        "weight of the difference between SSIM and its floor");
    key("laplacian", laplacian, "weights of the neighbours of a vertex in R_lap");
    key("displacement_weight", displacement_weight, {0, 1e9}, "",
        "weight of the squared difference of neighbouring offsets (MeshAdv)");
    key("variation_weight", variation_weight, {0, 1e9}, "",
        "weight of the total variation of the change");
    key("printability_weight", printability_weight, {0, 1e9}, "",
        "weight of the distance to the nearest printable colour");
    key("printer_colors", printer_colors,
        "file of printable colours, each line three numbers from 0 to 1; empty: mixes of process "
        "inks");
    key("max_displacement", max_displacement, {0, 1}, "object box / 2",
        "bound on the displacement of each vertex; 0: none");
  }
};

// ---- Schedule -----------------------------------------------------------------------------

/// How the learning rates decrease to final_rate.
enum class Schedule {
  kExponential,
  kCosine,  ///< stays near the full rate at the start and near the final rate at the end
};
[[nodiscard]] constexpr std::array<std::string_view, 2> enum_names(Schedule) {
  return {"exponential", "cosine"};
}

struct ScheduleOptions {
  int64_t steps = 450, views_per_step = 6, image_size = 224;
  scene::ViewDistribution view_distribution = scene::ViewDistribution::kDome;
  double appearance_rate = 1e-2, vertex_rate = 1e-4, final_rate = 0.5;
  Schedule schedule = Schedule::kExponential;
  double momentum = 0;
  int64_t epoch = 0, held_out_views = 24, patience = 0;
  int64_t checkpoint_every = 50;

  void keys(KeyList& key) {
    key("steps", steps, {1, 1e7}, "", "optimisation steps");
    key("views_per_step", views_per_step, {1, 256}, "", "new random views per step");
    key("image_size", image_size, {16, 4096}, "pixels", "side of the rendered pictures");
    key("view_distribution", view_distribution, "distribution of the random views");
    key("appearance_rate", appearance_rate, {0, 1}, "", "learning rate of the appearance");
    key("vertex_rate", vertex_rate, {0, 1}, "", "learning rate of vertex offsets");
    key("final_rate", final_rate, {1e-4, 1}, "", "final learning rate, as a share of the first");
    key("schedule", schedule, "how the learning rates decrease to final_rate");
    key("momentum", momentum, {0, 1}, "",
        "decay factor of the accumulated gradients (MI-FGSM), in addition to Adam's own; 0: none");
    key("epoch", epoch, {0, 1e7}, "steps",
        "steps of an epoch; after each epoch the surrogates are scored on held-out views, and "
        "the state with the highest success is kept; 0: no epochs");
    key("held_out_views", held_out_views, {1, 1e5}, "", "held-out views scored after each epoch");
    key("patience", patience, {0, 1e6}, "epochs",
        "stops after that many epochs without a higher success; 0: never");
    key("checkpoint_every", checkpoint_every, {1, 1e7}, "steps", "steps between checkpoints");
  }
};

// ---- Parts --------------------------------------------------------------------------------

/// A patch of the surface; only colours inside it may change.
struct StickerOptions {
  double area = 0, azimuth_deg = 0, elevation_deg = 0;
  std::filesystem::path mask;

  void keys(KeyList& key) {
    key("sticker_area", area, {0, 1}, "",
        "area of a round patch, as a share of the surface; only colours inside may change; 0: no "
        "patch");
    key("sticker_azimuth_deg", azimuth_deg, {-360, 360}, "degrees",
        "direction of the patch from the centre of the object");
    key("sticker_elevation_deg", elevation_deg, {-90, 90}, "degrees",
        "elevation of this direction");
    key("sticker_mask", mask,
        "picture in the layout of asset/clean.png: only colours in its light parts may change; "
        "takes "
        "precedence over the round patch");
  }
};

/// How a tile covers the surface.
enum class TileMapping {
  kAtlas,      ///< repeats over the charts of the texture
  kTriplanar,  ///< projected along the three axes
};
[[nodiscard]] constexpr std::array<std::string_view, 2> enum_names(TileMapping) {
  return {"atlas", "triplanar"};
}

/// Textures and tiles.
struct TileOptions {
  int64_t texture_size = 512, tile_size = 128;
  TileMapping mapping = TileMapping::kAtlas;
  double repeats = 4;

  void keys(KeyList& key) {
    key("texture_size", texture_size, {8, 8192}, "texels", "side of part texture");
    key("tile_size", tile_size, {4, 4096}, "texels", "side of part tile");
    key("tile_mapping", mapping,
        "how the tile covers the surface: over the charts of the texture, or along the three axes");
    key("tile_repeats", repeats, {0.1, 100}, "",
        "number of tiles along a side of the atlas or of the object's bounding box");
  }
};

// ---- All of it ----------------------------------------------------------------------------

struct AttackOptions {
  std::vector<object::Part> optimize = {object::Part::kGrid, object::Part::kMlp,
                                        object::Part::kVertices};
  ObjectiveOptions objective;
  NaturalnessOptions naturalness;
  ScheduleOptions schedule;
  EotOptions eot;
  StickerOptions sticker;
  TileOptions tile;

  /// True if attack.optimize names the part.
  [[nodiscard]] bool optimizes(object::Part part) const;

  void keys(KeyList& key) {
    key("optimize", optimize, "parts of the object that may change");
    objective.keys(key);
    tile.keys(key);
    sticker.keys(key);
    naturalness.keys(key);
    schedule.keys(key);
    key.group("eot", eot);
  }
};

/// A named set of options (attack.method): its changes to the defaults.
struct AttackPreset {
  std::string name, description;
  std::string source;  ///< the paper behind it
  void (*change)(AttackOptions& options);
};
[[nodiscard]] const std::vector<AttackPreset>& attack_presets();
[[nodiscard]] std::vector<std::string> attack_preset_names();
/// Throws InputError for an unknown name.
[[nodiscard]] const AttackPreset& attack_preset(const std::string& name);

/// True if the attack optimises the grid or the MLP of a field.
[[nodiscard]] bool needs_grid_mlp(const AttackOptions& options);
/// True if the attack needs a UV map of the object.
[[nodiscard]] bool needs_uv_map(const AttackOptions& options);

}  // namespace tt3d::attack
