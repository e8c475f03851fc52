#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "tt3d/appearance.h"
#include "tt3d/capture.h"
#include "tt3d/core.h"
#include "tt3d/eot.h"
#include "tt3d/mesh.h"
#include "tt3d/model.h"

/// The adversarial optimisation: paper, sections 3.2 to 3.5. Minimises over views and transforms
///   E L_f(t(render(V*, theta*, view)), y*) + beta (l1 R_rgb + l2 R_cd + l3 R_lap + l4 R_edge)
/// in the parameters of an appearance and the vertices.
namespace tt3d {

/// Parts of an object that an attack may change: the names attack.optimize takes.
[[nodiscard]] const std::vector<std::string>& attack_parts();

struct AttackOptions {
  /// Parts that are optimised; those of one look and, beside them, vertices.
  std::vector<std::string> optimize = {"grid", "mlp", "vertices"};
  int64_t texture_size = 512;          ///< texels a side, of part texture
  int64_t tile_size = 128;             ///< texels a side, of part tile
  std::string tile_mapping = "atlas";  ///< how the tile covers the surface: tile_mapping_names
  double tile_repeats = 4;             ///< tiles along the side of the atlas or of the object's box
  double sticker_area = 0;  ///< share of the surface where colours are free: a round patch; 0: all
  double sticker_azimuth_deg = 0, sticker_elevation_deg = 0;  ///< the side that it sits on
  std::filesystem::path sticker_mask;       ///< picture over the atlas, free where it is light
  std::string objective = "cross-entropy";  ///< one of objective_names
  std::string goal = "targeted";            ///< targeted; untargeted: away from the class
  std::string ensemble = "losses";          ///< how several surrogates combine: ensemble_names
  double beta = 1000;                       ///< strength of naturalness
  double rgb_weight = 1;                    ///< l1
  std::string color_space = "rgb";          ///< where R_rgb measures: one of color_space_names
  double chamfer_weight = 3000;             ///< l2
  double laplacian_weight = 1e-3;           ///< l3
  double edge_weight = 1e-2;                ///< l4
  std::string laplacian = "uniform";        ///< weights of R_lap: one of laplacian_names
  double psnr_floor = 0;  ///< dB; below 0 disables: R_rgb counts only beyond this error
  double ssim_floor = 0;  ///< SSIM to the clean pictures; what is missing to it counts; 0: nothing
  double ssim_weight = 0.05;       ///< weight of what is missing
  double displacement_weight = 0;  ///< of the squared difference of neighbours' offsets (MeshAdv)
  double variation_weight = 0;     ///< of the total variation of the change, in the pictures
  double printability_weight = 0;  ///< of the distance to the nearest printable colour
  std::filesystem::path printer_colors;  ///< the printable ones: three numbers in [0,1] a line;
                                         ///< empty: mixes of process inks
  double max_displacement = 0;           ///< hard bound on a vertex's way, object box / 2; 0: none
  int64_t steps = 800;
  int64_t views_per_step = 6;
  int64_t image_size = 256;  ///< rendered pixels a side
  std::string view_distribution = "dome";
  double appearance_rate = 1e-2;
  double vertex_rate = 1e-4;
  double final_rate = 0.5;               ///< share of the rates left at the end
  std::string schedule = "exponential";  ///< the way there: one of schedule_names
  double momentum = 0;  ///< of past gradients in each step's direction, beside Adam's own; 0: none
  EotOptions eot;
  /// Clean feature mixup (Byun et al., CVPR 2023): with this probability a layer of a surrogate
  /// sees, beside the picture, the clean object in the same view; 0: never.
  double feature_mix = 0;
  double feature_mix_share = 0.75;  ///< largest share of the clean features in a channel
  int64_t checkpoint_every = 50;
  /// Steps an epoch. After each, the surrogates are asked about held-out views as an evaluation
  /// would show them, and the state with the highest success is what the attack gives; 0: never.
  int64_t epoch = 0;
  int64_t held_out_views = 24;
  int64_t patience = 0;  ///< stops after that many epochs without a higher success; 0: never
};

/// exponential; cosine: stays near the full rate first, and near the final one at the end.
[[nodiscard]] const std::vector<std::string>& schedule_names();
/// atlas: the tile repeats over the texture's charts; triplanar: along the three axes.
[[nodiscard]] const std::vector<std::string>& tile_mapping_names();
/// rgb: squared distance of sRGB colours; lab: of CIE L*a*b*, in hundreds.
[[nodiscard]] const std::vector<std::string>& color_space_names();
/// uniform, cotangent.
[[nodiscard]] const std::vector<std::string>& laplacian_names();

/// A named choice of options (attack.method): what it changes of the program's defaults.
struct AttackPreset {
  std::string name, description;
  std::string source;  ///< the paper it follows
  void (*change)(AttackOptions& options);
};
[[nodiscard]] const std::vector<AttackPreset>& attack_presets();
[[nodiscard]] std::vector<std::string> attack_preset_names();
/// Throws InputError for an unknown name.
[[nodiscard]] const AttackPreset& attack_preset(const std::string& name);

/// True if the attack changes a field's grid or MLP.
[[nodiscard]] bool needs_grid_mlp(const AttackOptions& options);
/// True if the attack needs AttackInput::map.
[[nodiscard]] bool needs_texture_map(const AttackOptions& options);

/// The shape and look that the attack changes, and the models it may see. Mesh and appearance lie
/// on the device that it runs on; the models follow.
struct AttackInput {
  TriMesh mesh;
  std::shared_ptr<const Appearance> appearance;
  /// Where the surface lies in a texture, for parts texture and tile; undefined where none asks.
  TextureMap map;
  at::Tensor texels;  ///< [S,S,3] uint8, the clean colours there, for part texture
  ViewFrame frame;
  std::vector<std::shared_ptr<const Classifier>> surrogates;
  /// The class that the objective is about in each surrogate's labels: the target or, untargeted,
  /// the true class.
  std::vector<int64_t> classes;
  /// Objects that wear the same look, in a universal attack: their meshes, clean looks and frames
  /// count, and the mean over all objects is what is optimised.
  std::vector<AttackInput> also;
};

/// One row of the log.
struct AttackCurvePoint {
  int64_t step;
  double loss, objective, rgb, chamfer, laplacian, edge, success;
};

/// What an epoch came to.
struct AttackEpoch {
  int64_t step;               ///< steps so far
  double objective, success;  ///< means over the epoch's steps
  double held_out;            ///< success on the held-out views after it, a mean over surrogates
};

struct AttackResult {
  TriMesh mesh;                                  ///< V*, same faces
  std::shared_ptr<const Appearance> appearance;  ///< theta*
  std::vector<AttackCurvePoint> curves;
  std::vector<AttackEpoch> epochs;  ///< empty without attack.epoch
};

/// What the attack's look makes of another of its objects, whose shape stays. Throws InputError for
/// a look that fits its own object alone.
[[nodiscard]] AttackResult worn_result(const AttackResult& result, const AttackInput& other);

/// Runs the attack; resumes from `checkpoint` if it exists, to the same bytes.
/// Throws NumericError when it diverges for good.
[[nodiscard]] AttackResult run_attack(const AttackInput& input, const AttackOptions& options,
                                      uint64_t seed, const std::filesystem::path& checkpoint,
                                      Progress& progress);

/// Saves and loads what an attack produced (attack.safetensors).
void save_attack(const AttackResult& result, const std::filesystem::path& path);
[[nodiscard]] AttackResult load_attack(const std::filesystem::path& path);
/// CSV of the curves, a row a step.
[[nodiscard]] std::string curves_csv(const std::vector<AttackCurvePoint>& curves);
/// CSV of the epochs, a row each.
[[nodiscard]] std::string epochs_csv(const std::vector<AttackEpoch>& epochs);

// ---- Objective ----------------------------------------------------------------------------

/// cross-entropy; logit, the bare logit (Zhao et al. 2021); margin, the logit against the others'
/// log-sum (after Carlini & Wagner 2017).
[[nodiscard]] const std::vector<std::string>& objective_names();
/// targeted, untargeted.
[[nodiscard]] const std::vector<std::string>& goal_names();
/// What is averaged over surrogates: losses; logits, as one model (Dong et al. 2018); gradients,
/// each scaled to length 1 where it reaches the rendered pictures, so that none drowns the others.
[[nodiscard]] const std::vector<std::string>& ensemble_names();

/// The objective L_f of a batch, a mean over pictures: logits [N,classes], `index` of the class
/// that they shall show (targeted) or shall not (untargeted: the targeted loss, negated). Throws
/// InputError for unknown names.
[[nodiscard]] at::Tensor objective_loss(const std::string& name, const std::string& goal,
                                        const at::Tensor& logits, int64_t index);

}  // namespace tt3d
