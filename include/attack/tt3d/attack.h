#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <vector>

#include "tt3d/attack_options.h"
#include "tt3d/core.h"
#include "tt3d/model.h"
#include "tt3d/object.h"
#include "tt3d/record.h"
#include "tt3d/scene.h"

/// The adversarial optimisation (paper, sections 3.2 to 3.5). Minimises, in expectation over views
/// and transforms,
///   E L_f(t(render(V*, theta*, view)), y*) + beta (l1 R_rgb + l2 R_cd + l3 R_lap + l4 R_edge)
/// with respect to the parameters of an appearance and the vertices.
namespace tt3d::attack {

/// The object that the attack changes, and the models it may use. The attack runs on the device of
/// the object; the models are moved there.
struct AttackInput {
  object::Object object;  ///< has a map if needs_uv_map(options)
  at::Tensor texels;      ///< [S,S,3] uint8, clean colours as a texture over the map; for part
                          ///< texture
  scene::ViewFrame frame;
  std::vector<std::shared_ptr<const model::Classifier>> surrogates;
  /// The class of the objective in each surrogate's labels: the target or, untargeted, the true
  /// class.
  std::vector<int64_t> classes;
  /// Further objects of a universal attack, which share the appearance. Only their meshes, clean
  /// appearances and frames are used. The attack optimises the mean over all objects.
  std::vector<AttackInput> also;
};

struct AttackResult {
  object::Object object;  ///< V* and theta*, with the same faces
  record::Curves curves;
  std::vector<record::Epoch> epochs;  ///< empty without attack.epoch
};

/// Applies the attacked appearance to another object; its shape stays unchanged. Throws InputError
/// if the appearance cannot be used on another object.
[[nodiscard]] AttackResult apply_appearance(const AttackResult& result, const AttackInput& other);

/// Runs the attack. Resumes from `checkpoint` if it exists, with the same result to the byte.
/// Throws NumericError if the attack still diverges after three roll-backs.
[[nodiscard]] AttackResult run_attack(const AttackInput& input, const AttackOptions& options,
                                      uint64_t seed, const std::filesystem::path& checkpoint,
                                      Progress& progress);

/// Saves object and curves (attack.safetensors); object::load_object reads the object.
void save_attack(const AttackResult& result, const std::filesystem::path& path);

/// The objective L_f, averaged over a batch. logits [N,classes]; `index`: the target class or,
/// untargeted, the true class. The untargeted loss is the negated targeted loss.
[[nodiscard]] at::Tensor objective_loss(Objective objective, Goal goal, const at::Tensor& logits,
                                        int64_t index);

}  // namespace tt3d::attack
