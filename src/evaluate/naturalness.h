#pragma once

#include <memory>
#include <nlohmann/json.hpp>

#include "tt3d/asset.h"
#include "tt3d/evaluate.h"
#include "tt3d/scene.h"
#include "tt3d/tool.h"

namespace tt3d::evaluate {

/// Compares adversarial and clean pictures, over the whole frame and over the box around the
/// object.
class PictureComparison {
 public:
  PictureComparison(const EvaluateOptions& options, const asset::TexturedMesh& asset);
  /// Adds one view: pictures [H,W,3] in [0,1].
  void add(const at::Tensor& adversarial, const at::Tensor& clean, const scene::Camera& camera);
  /// Means over the views, with LPIPS if the options ask for it.
  [[nodiscard]] record::NaturalnessRecord finish(Progress& progress) const;

 private:
  const EvaluateOptions& options_;
  at::Tensor vertices_;  ///< [V,3]
  double psnr_ = 0, ssim_ = 0, psnr_box_ = 0, ssim_box_ = 0;
  int64_t count_ = 0;
  std::unique_ptr<ExchangeFolder> folder_;  ///< pictures for LPIPS
  nlohmann::json pairs_ = nlohmann::json::array();
};

}  // namespace tt3d::evaluate
