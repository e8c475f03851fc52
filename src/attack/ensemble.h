#pragma once

#include <ATen/core/Tensor.h>

#include <optional>
#include <vector>

#include "tt3d/attack.h"

namespace tt3d {

/// The objective L_f over all surrogates, combined as attack.ensemble says. Each surrogate sees
/// its own draw of the transforms; only the mean of logits needs one draw for all.
class Ensemble {
 public:
  /// Throws InputError where surrogates do not fit together, or the photographs are missing.
  Ensemble(const AttackInput& input, const AttackOptions& options, uint64_t seed);
  /// pictures [N,4,H,W], premultiplied; `clean`: the clean object in the same views, for
  /// attack.feature_mix, else undefined. `hits` receives the share of pictures for which the
  /// attack has its way, of each surrogate that was asked.
  [[nodiscard]] at::Tensor loss(const at::Tensor& pictures, const at::Tensor& clean, int64_t step,
                                std::vector<at::Tensor>& hits) const;

  /// Mean over surrogates of the share of pictures [N,3,h,w], as they are preprocessed by their
  /// users, for which the attack has its way.
  [[nodiscard]] double success(const at::Tensor& pictures) const;

 private:
  /// The step's views dealt out to the surrogates in turn: the mean of losses in expectation, at
  /// the price of one surrogate.
  [[nodiscard]] at::Tensor loss_of_shared_views(const at::Tensor& pictures, const at::Tensor& clean,
                                                int64_t step, std::vector<at::Tensor>& hits) const;
  [[nodiscard]] at::Tensor won(size_t model, const at::Tensor& logits) const;
  [[nodiscard]] at::Tensor logits(size_t model, const at::Tensor& pictures, const at::Tensor& clean,
                                  int64_t draw, std::vector<at::Tensor>& hits) const;
  [[nodiscard]] at::Tensor transformed(size_t model, const at::Tensor& pictures, uint64_t seed,
                                       int64_t draw) const;
  [[nodiscard]] at::Tensor objective(const at::Tensor& logits, size_t model) const;

  const AttackInput& input_;
  const AttackOptions& options_;
  uint64_t seed_;
  std::optional<Backgrounds> photographs_;
};

/// The same tensor, whose gradient comes back with norm `length` (0 stays 0).
[[nodiscard]] at::Tensor with_gradient_of_length(const at::Tensor& x, double length);

}  // namespace tt3d
