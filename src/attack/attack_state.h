#pragma once

#include <ATen/core/Tensor.h>

#include <filesystem>
#include <memory>
#include <vector>

#include "tt3d/attack.h"

namespace tt3d {

/// The state that did best on the held-out views so far.
struct BestState {
  std::vector<at::Tensor> tensors;  ///< offsets and the appearance's parameters
  double success = -1;
  int64_t age = 0;  ///< epochs since
};

/// Everything that changes while attacking; saved and restored whole.
struct AttackState {
  at::Tensor offsets;  ///< [V,3]
  std::unique_ptr<Appearance> appearance;
  std::vector<at::Tensor> moment1, moment2;  ///< of free_parameters, in its order
  std::vector<at::Tensor> velocity;          ///< likewise, where attack.momentum is not 0
  std::vector<AttackCurvePoint> curves;
  std::vector<AttackEpoch> epochs;
  BestState best;  ///< empty without epochs
  int64_t step = 0;
  Recovery recovery;
};

/// A tensor that is optimised, and its learning rate.
struct FreeParameter {
  at::Tensor tensor;
  double rate;
};
/// True if attack.optimize names the part.
[[nodiscard]] bool optimizes(const AttackOptions& options, const std::string& part);
/// What attack.optimize names, vertex offsets first.
[[nodiscard]] std::vector<FreeParameter> free_parameters(const AttackState& state,
                                                         const AttackOptions& options);

/// The look whose parts are optimised, with the clean object's colours where it can have them.
/// Throws InputError for parts that do not go together, or for a texture map that is missing.
[[nodiscard]] std::unique_ptr<Appearance> starting_look(const AttackInput& input,
                                                        const AttackOptions& options);

/// The state before the first step. Throws InputError for a part that this object has not.
[[nodiscard]] AttackState fresh_state(const AttackInput& input, const AttackOptions& options);

void save_state(const AttackState& state, const std::filesystem::path& path);
/// Restores into a fresh state of the same attack.
void load_state(const std::filesystem::path& path, AttackState& state);

/// The offsets and all of the appearance's parameters.
[[nodiscard]] std::vector<at::Tensor> object_tensors(const AttackState& state);

/// The log as a tensor [steps,8] float64, and back.
[[nodiscard]] at::Tensor curves_tensor(const std::vector<AttackCurvePoint>& curves);
[[nodiscard]] std::vector<AttackCurvePoint> curves_from(const TensorFile& file);

}  // namespace tt3d
