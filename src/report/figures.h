#pragma once

#include <optional>
#include <string>
#include <vector>

#include "html.h"

namespace tt3d::report {

/// A victim of the evaluation record.
struct VictimFigures {
  std::string name;
  bool surrogate = false;  ///< the attack saw it
  std::optional<double> asr, asr_low, asr_high, clean_accuracy, asr_on_correct;
  std::optional<double> asr_on_correct_n, target_probability;
};

/// The figures of a run, from its JSON files; what is absent stays empty.
struct RunFigures {
  std::string target, true_class, renderer, background, distribution;
  std::optional<double> views, size;
  std::vector<VictimFigures> victims;
  std::optional<double> psnr, ssim, lpips, field_psnr, mesh_psnr, faces;
  std::optional<bool> closed;
  /// Mean ASR of the victims the attack saw, or of the others; nothing where there are none.
  [[nodiscard]] std::optional<double> mean_asr(bool surrogate) const;
};

[[nodiscard]] RunFigures run_figures(const Json& record, const Json& field, const Json& mesh,
                                     const std::vector<std::string>& surrogates);

/// One paragraph that tells the result in words.
[[nodiscard]] std::string summary(const RunFigures& figures);
/// The few figures that matter most, large.
[[nodiscard]] std::string headline(const RunFigures& figures);
/// A row a victim.
[[nodiscard]] std::string result_table(const RunFigures& figures);
/// Naturalness, field and mesh quality.
[[nodiscard]] std::string quality_list(const RunFigures& figures);

}  // namespace tt3d::report
