#include "tt3d/attack.h"

namespace tt3d::attack {
namespace {

/// Official code, commit edceec9 (MIT), and section 4.1 of the paper, without the bugs of the code:
/// the background is composited after alpha, and each step draws new views.
void paper_numbers(AttackOptions& o) {
  o.objective.loss = Objective::kCrossEntropy;
  o.naturalness.beta = 1000;
  o.naturalness.psnr_floor = o.naturalness.ssim_floor = 0;
  o.schedule.steps = 25000;  // 250 epochs of 100 views
  o.schedule.views_per_step = 1;
  o.schedule.image_size = 400;
  o.schedule.view_distribution = scene::ViewDistribution::kPaper;
  EotOptions& e = o.eot;
  e.scale_low = 0.67;  // the code pads the picture by a fifth to a half
  e.scale_high = 0.83;
  e.shift = 0;
  e.rotation_deg = 90;
  e.brightness = e.contrast = e.saturation = 0.8;
  e.blur = 1.4;  // OpenCV's sigma for a kernel of 7 pixels
  e.noise = 0;
  e.plain_background = 0;
}

/// The baseline of the paper's table 1: "no limitations on the color modifications".
void mesh_baseline(AttackOptions& o) {
  o.optimize = {object::Part::kVertexColors, object::Part::kVertices};
  o.naturalness.rgb_weight = 0;
  o.naturalness.psnr_floor = o.naturalness.ssim_floor = 0;
}

/// The shape alone; their Laplacian loss keeps the displacement smooth. The weight is ours.
void meshadv_shape(AttackOptions& o) {
  o.optimize = {object::Part::kVertices};
  o.objective.loss = Objective::kCrossEntropy;
  o.naturalness.chamfer_weight = o.naturalness.laplacian_weight = o.naturalness.edge_weight = 0;
  o.naturalness.displacement_weight = 100;
  o.naturalness.psnr_floor = o.naturalness.ssim_floor = 0;
}

/// The colours alone, with the total variation of the change as loss. The weight is ours.
void meshadv_texture(AttackOptions& o) {
  o.optimize = {object::Part::kVertexColors};
  o.objective.loss = Objective::kCrossEntropy;
  o.naturalness.rgb_weight = 0;
  o.naturalness.variation_weight = 1e-2;
  o.naturalness.psnr_floor = o.naturalness.ssim_floor = 0;
}

/// Only a patch changes, without limits.
void sticker(AttackOptions& o) {
  o.optimize = {object::Part::kGrid, object::Part::kMlp};
  o.sticker.area = 0.1;
  o.naturalness.rgb_weight = 0;
  o.naturalness.psnr_floor = o.naturalness.ssim_floor = 0;
}

/// A texture without regularisers: the baseline of comparisons.
void plain_texture(AttackOptions& o) {
  o.optimize = {object::Part::kTexture};
  o.objective.loss = Objective::kCrossEntropy;
  o.schedule.appearance_rate = 0.03;
  o.naturalness.rgb_weight = 0;
  o.naturalness.psnr_floor = o.naturalness.ssim_floor = 0;
}

/// Equation 2 of the paper: the likelihood, with the expected distance in LAB as a penalty. The
/// weight is ours.
void advturtle(AttackOptions& o) {
  plain_texture(o);
  o.naturalness.color_space = ColorSpace::kLab;
  o.naturalness.rgb_weight = 1;
  o.naturalness.beta = 100;
}

/// Light, material and normals of a shaded surface. Our floor on PSNR takes the place of their L2
/// bound.
void physical(AttackOptions& o) {
  o.optimize = {object::Part::kMaterial, object::Part::kNormals, object::Part::kLights};
  o.objective.loss = Objective::kCrossEntropy;
}

/// The texture of the whole surface, with losses for smoothness and printability. The weights are
/// ours.
void full_coverage(AttackOptions& o) {
  plain_texture(o);
  o.naturalness.variation_weight = 1e-3;
  o.naturalness.printability_weight = 1e-3;
}

/// One tile covers the whole surface.
void repeated(AttackOptions& o) {
  plain_texture(o);
  o.optimize = {object::Part::kTile};
}

void triplanar(AttackOptions& o) {
  repeated(o);
  o.tile.mapping = TileMapping::kTriplanar;
  o.naturalness.variation_weight = 1e-3;  // their smoothness loss
}

/// The settings that transfer best for the same number of surrogate passes (decision 11). Each view
/// is shown to one surrogate, so a step has more views; the steps are small. It needs several
/// surrogates and time.
void strong(AttackOptions& o) {
  o.objective.ensemble = EnsembleMode::kViews;
  o.schedule.views_per_step = 3;
  o.schedule.steps = 2400;
  o.schedule.appearance_rate = 2e-2;
}

constexpr const char* kTt3d = "Huang et al., TT3D, CVPR 2024";
constexpr const char* kMeshAdv = "Xiao et al., MeshAdv, CVPR 2019";

}  // namespace

const std::vector<AttackPreset>& attack_presets() {
  static const std::vector<AttackPreset> presets = {
      {"dual", "appearance grid, MLP and vertices", kTt3d, [](AttackOptions&) {}},
      {"dual-texture-only", "appearance grid and MLP; the shape stays", kTt3d,
       [](AttackOptions& o) {
         o.optimize = {object::Part::kGrid, object::Part::kMlp};
       }},
      {"mlp", "appearance MLP and vertices", kTt3d,
       [](AttackOptions& o) {
         o.optimize = {object::Part::kMlp, object::Part::kVertices};
       }},
      {"grid", "appearance grid and vertices", kTt3d,
       [](AttackOptions& o) {
         o.optimize = {object::Part::kGrid, object::Part::kVertices};
       }},
      {"mesh", "vertex colours without limits, and vertices",
       "the baseline of TT3D, after Xiao et al., MeshAdv, CVPR 2019", mesh_baseline},
      {"paper", "dual with the settings of the paper: 25,000 steps of one view, cross-entropy",
       kTt3d, paper_numbers},
      {"sticker", "grid and MLP, without limits, inside a patch of a tenth of the surface",
       "after Oslund et al., Multiview robust adversarial stickers, 2022", sticker},
      {"strong", "as dual, each view shown to one of several surrogates: more views and steps",
       "ours", strong},
      {"texture", "a texture without limits: the baseline of comparisons",
       "after Athalye et al., Synthesizing robust adversarial examples, ICML 2018", plain_texture},
      {"advturtle", "a texture close to the clean one in L*a*b*",
       "Athalye et al., Synthesizing robust adversarial examples, ICML 2018", advturtle},
      {"physical", "material, normals and lights of the shaded object",
       "after Zeng et al., Adversarial attacks beyond the image space, CVPR 2019", physical},
      {"full-coverage", "a texture over the whole surface, smooth and printable",
       "after Wang et al., FCA, AAAI 2022", full_coverage},
      {"repeated", "one tile repeated over the surface", "after Suryanto et al., DTA, CVPR 2022",
       repeated},
      {"triplanar", "one tile along the three axes, for one object or several",
       "after Suryanto et al., ACTIVE, ICCV 2023", triplanar},
      {"meshadv-shape", "vertices alone, their displacement kept smooth", kMeshAdv, meshadv_shape},
      {"meshadv-texture", "vertex colours alone, their change kept smooth", kMeshAdv,
       meshadv_texture},
  };
  return presets;
}

std::vector<std::string> attack_preset_names() {
  std::vector<std::string> names;
  for (const AttackPreset& p : attack_presets()) names.push_back(p.name);
  return names;
}

const AttackPreset& attack_preset(const std::string& name) {
  for (const AttackPreset& p : attack_presets()) {
    if (p.name == name) return p;
  }
  const std::string near = nearest_name(name, attack_preset_names());
  throw InputError("attack.method: unknown '" + name + "'" +
                   (near.empty() ? "; 'tt3d attack --list' lists the methods"
                                 : "; did you mean '" + near + "'?"));
}

}  // namespace tt3d::attack
