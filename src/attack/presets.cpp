#include "tt3d/attack.h"

namespace tt3d {
namespace {

/// Official code, commit edceec9 (MIT), and section 4.1 of the paper. Its bugs are not repeated:
/// the background is composited after alpha and views are drawn afresh each step.
void paper_numbers(AttackOptions& o) {
  o.objective = "cross-entropy";
  o.beta = 1000;
  o.psnr_floor = o.ssim_floor = 0;
  o.steps = 25000;  // 250 epochs of 100 views
  o.views_per_step = 1;
  o.image_size = 400;
  o.view_distribution = "paper";
  EotOptions& e = o.eot;
  e.scale_low = 0.67;  // the code pads the picture by a fifth to a half
  e.scale_high = 0.83;
  e.shift = 0;
  e.rotation_deg = 90;
  e.brightness = e.contrast = e.saturation = 0.8;
  e.blur = 1.4;  // the sigma that OpenCV takes for a kernel of 7
  e.noise = 0;
  e.plain_background = 0;
}

/// The baseline of the paper's table 1: "no limitations on the color modifications".
void mesh_baseline(AttackOptions& o) {
  o.optimize = {"vertex-colors", "vertices"};
  o.rgb_weight = 0;
  o.psnr_floor = o.ssim_floor = 0;
}

/// The shape alone, neighbours kept moving together (their Laplacian loss). The weight is ours.
void meshadv_shape(AttackOptions& o) {
  o.optimize = {"vertices"};
  o.objective = "cross-entropy";
  o.chamfer_weight = o.laplacian_weight = o.edge_weight = 0;
  o.displacement_weight = 100;
  o.psnr_floor = o.ssim_floor = 0;
}

/// The colours alone, under total variation of the change. The weight is ours.
void meshadv_texture(AttackOptions& o) {
  o.optimize = {"vertex-colors"};
  o.objective = "cross-entropy";
  o.rgb_weight = 0;
  o.variation_weight = 1e-2;
  o.psnr_floor = o.ssim_floor = 0;
}

/// Nothing but a patch changes, and that freely.
void sticker(AttackOptions& o) {
  o.optimize = {"grid", "mlp"};
  o.sticker_area = 0.1;
  o.rgb_weight = 0;
  o.psnr_floor = o.ssim_floor = 0;
}

/// A texture with nothing to hold it back: what results are compared with.
void plain_texture(AttackOptions& o) {
  o.optimize = {"texture"};
  o.objective = "cross-entropy";
  o.appearance_rate = 0.03;
  o.rgb_weight = 0;
  o.psnr_floor = o.ssim_floor = 0;
}

/// Equation 2 of the paper: the expected distance in LAB, weighed against the likelihood. The
/// weight is ours.
void advturtle(AttackOptions& o) {
  plain_texture(o);
  o.color_space = "lab";
  o.rgb_weight = 1;
  o.beta = 100;
}

/// Light, material and normals of a shaded surface; their L2 bound is our floor on PSNR.
void physical(AttackOptions& o) {
  o.optimize = {"material", "normals", "lights"};
  o.objective = "cross-entropy";
}

/// The whole body's texture under smoothness and printability. The weights are ours.
void full_coverage(AttackOptions& o) {
  plain_texture(o);
  o.variation_weight = 1e-3;
  o.printability_weight = 1e-3;
}

/// One tile paints the whole surface.
void repeated(AttackOptions& o) {
  plain_texture(o);
  o.optimize = {"tile"};
}

void triplanar(AttackOptions& o) {
  repeated(o);
  o.tile_mapping = "triplanar";
  o.variation_weight = 1e-3;  // their smoothness
}

/// What carries furthest at equal passes of the surrogates (decision 11): each view is shown to one
/// of them, so that there are more views, in small steps. Give it several surrogates, and time.
void strong(AttackOptions& o) {
  o.ensemble = "views";
  o.views_per_step = 3;
  o.steps = 2400;
  o.appearance_rate = 2e-2;
}

constexpr const char* kTt3d = "Huang et al., TT3D, CVPR 2024";
constexpr const char* kMeshAdv = "Xiao et al., MeshAdv, CVPR 2019";

}  // namespace

const std::vector<AttackPreset>& attack_presets() {
  static const std::vector<AttackPreset> presets = {
      {"dual", "appearance grid, MLP and vertices", kTt3d, [](AttackOptions&) {}},
      {"dual-texture-only", "appearance grid and MLP; the shape stays", kTt3d,
       [](AttackOptions& o) {
         o.optimize = {"grid", "mlp"};
       }},
      {"mlp", "appearance MLP and vertices", kTt3d,
       [](AttackOptions& o) {
         o.optimize = {"mlp", "vertices"};
       }},
      {"grid", "appearance grid and vertices", kTt3d,
       [](AttackOptions& o) {
         o.optimize = {"grid", "vertices"};
       }},
      {"mesh", "vertex colours without limits, and vertices",
       "the baseline of TT3D, after Xiao et al., MeshAdv, CVPR 2019", mesh_baseline},
      {"paper", "dual with the paper's numbers: 25,000 steps of one view, cross-entropy", kTt3d,
       paper_numbers},
      {"sticker", "grid and MLP, without limits, inside a patch of a tenth of the surface",
       "after Oslund et al., Multiview robust adversarial stickers, 2022", sticker},
      {"strong", "as dual, each view shown to one of several surrogates: more views and steps",
       "ours", strong},
      {"texture", "a texture without limits; the plain attack that others are compared with",
       "after Athalye et al., Synthesizing robust adversarial examples, ICML 2018", plain_texture},
      {"advturtle", "a texture near to the clean one in L*a*b*",
       "Athalye et al., Synthesizing robust adversarial examples, ICML 2018", advturtle},
      {"physical", "material, normals and lights of the shaded object",
       "after Zeng et al., Adversarial attacks beyond the image space, CVPR 2019", physical},
      {"full-coverage", "a texture over the whole body, smooth and printable",
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
  throw InputError(
      "attack.method: unknown '" + name + "'" +
      (near.empty() ? "; 'tt3d attack --list' has them" : "; did you mean '" + near + "'?"));
}

}  // namespace tt3d
