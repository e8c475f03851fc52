#pragma once

#include <ATen/core/Tensor.h>

#include <optional>
#include <vector>

#include "tt3d/attack.h"
#include "tt3d/scene.h"

namespace tt3d::attack {

/// The objective L_f over all surrogates, combined by attack.ensemble. Each surrogate gets its own
/// draw of the transforms; the mean of logits uses one draw for all.
class Ensemble {
 public:
  /// Throws InputError if the surrogates cannot be combined or the photographs are missing.
  Ensemble(const AttackInput& input, const AttackOptions& options, uint64_t seed);
  /// pictures [N,4,H,W], premultiplied; `clean`: the clean object in the same views, for
  /// attack.feature_mix, else undefined. `hits` receives the share of pictures on which the attack
  /// succeeds, one value for each surrogate that ran.
  [[nodiscard]] at::Tensor loss(const at::Tensor& pictures, const at::Tensor& clean, int64_t step,
                                std::vector<at::Tensor>& hits) const;

  /// Share of the pictures [N,3,h,w] on which the attack succeeds, mean over the surrogates. Each
  /// surrogate applies the preprocessing of its model card.
  [[nodiscard]] double success(const at::Tensor& pictures) const;

 private:
  /// Shows each view to one surrogate, in turn. The expectation equals the mean of the losses; the
  /// cost is that of one surrogate.
  [[nodiscard]] at::Tensor loss_of_shared_views(const at::Tensor& pictures, const at::Tensor& clean,
                                                int64_t step, std::vector<at::Tensor>& hits) const;
  /// Share of pictures on which the attack succeeds.
  [[nodiscard]] at::Tensor success_share(size_t model, const at::Tensor& logits) const;
  [[nodiscard]] at::Tensor logits(size_t model, const at::Tensor& pictures, const at::Tensor& clean,
                                  int64_t draw, std::vector<at::Tensor>& hits) const;
  [[nodiscard]] at::Tensor transformed(size_t model, const at::Tensor& pictures, uint64_t seed,
                                       int64_t draw) const;
  [[nodiscard]] at::Tensor objective(const at::Tensor& logits, size_t model) const;

  const AttackInput& input_;
  const AttackOptions& options_;
  uint64_t seed_;
  std::optional<scene::Backgrounds> photographs_;
};

/// The same tensor; its gradient is scaled to norm `length` (0 stays 0).
[[nodiscard]] at::Tensor with_gradient_of_length(const at::Tensor& x, double length);

}  // namespace tt3d::attack
