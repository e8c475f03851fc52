#pragma once

#include <memory>
#include <nlohmann/json.hpp>

#include "tt3d/evaluate.h"
#include "tt3d/tool.h"

namespace tt3d {

/// Sums of the measures between adversarial and clean pictures, over frame and box.
class Naturalness {
 public:
  Naturalness(const EvaluateOptions& options, const TexturedMesh& asset);
  /// One view: pictures [H,W,3] in [0,1].
  void add(const at::Tensor& adversarial, const at::Tensor& clean, const Camera& camera);
  /// Means, and LPIPS where asked for, into the record.
  void finish(EvalRecord& record, Progress& progress) const;

 private:
  const EvaluateOptions& options_;
  at::Tensor vertices_;  ///< [V,3]
  double psnr_ = 0, ssim_ = 0, psnr_box_ = 0, ssim_box_ = 0;
  int64_t count_ = 0;
  std::unique_ptr<ExchangeFolder> folder_;  ///< pictures for LPIPS
  nlohmann::json pairs_ = nlohmann::json::array();
};

}  // namespace tt3d
