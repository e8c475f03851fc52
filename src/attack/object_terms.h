#pragma once

#include <ATen/core/Tensor.h>

#include <vector>

#include "ensemble.h"
#include "naturalness.h"
#include "tt3d/attack.h"

namespace tt3d::attack {

/// An optimised tensor and its learning rate.
struct FreeParameter {
  at::Tensor tensor;
  double rate;
};

/// Loss and gradients of one object. A universal attack has several.
class ObjectTerms {
 public:
  ObjectTerms(const AttackInput& input, const AttackOptions& options, uint64_t seed);

  /// Views per step; halve_views lowers the number.
  [[nodiscard]] int64_t views() const { return views_; }
  void halve_views() { views_ /= 2; }

  /// Computes the figures of a step and the gradients of the loss with respect to `parameters`.
  /// `offsets` [V,3] are added to the rest vertices.
  record::CurvePoint compute(const object::Appearance& appearance, const at::Tensor& offsets,
                             int64_t step, const std::vector<at::Tensor>& parameters,
                             std::vector<at::Tensor>& grads) const;

  /// Success on held-out views over white, with the preprocessing of each model card. An evaluation
  /// measures the same, but on views of another stream.
  [[nodiscard]] double held_out_success(const object::Appearance& appearance,
                                        const at::Tensor& offsets) const;

  [[nodiscard]] const AttackInput& input() const { return input_; }

 private:
  [[nodiscard]] std::vector<scene::Camera> cameras(int64_t step) const;
  [[nodiscard]] Rendering render(const object::Appearance& appearance, const at::Tensor& vertices,
                                 int64_t step) const;

  const AttackInput& input_;
  const AttackOptions& options_;
  uint64_t seed_;
  int64_t views_;
  Ensemble ensemble_;
  Naturalness naturalness_;
  mesh::RenderMesh prepared_;
};

}  // namespace tt3d::attack
