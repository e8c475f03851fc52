#pragma once

#include <optional>
#include <string>
#include <vector>

#include "tt3d/record.h"

namespace tt3d::report {

/// A victim of an evaluation; a surrogate if the attack used it.
struct ShownVictim {
  record::VictimRecord figures;
  bool surrogate = false;
};

/// The input of the text and tables of the page.
struct RunFigures {
  std::optional<record::EvaluationRecord> evaluation;
  std::vector<ShownVictim> victims;  ///< surrogates first
  std::optional<record::FieldMetrics> field;
  std::optional<record::MeshMetrics> mesh;
  /// Mean ASR of the surrogates, or of the other victims; nothing if there are none.
  [[nodiscard]] std::optional<double> mean_asr(bool surrogate) const;
};

/// The victims of an evaluation, surrogates first.
[[nodiscard]] std::vector<ShownVictim> shown_victims(const record::EvaluationRecord& evaluation,
                                                     const std::vector<std::string>& surrogates);

/// The first synonym of a class: "hen" of "hen, biddy".
[[nodiscard]] std::string first_name(const record::ClassId& id);

/// One paragraph with the result in words.
[[nodiscard]] std::string summary(const RunFigures& figures);
/// The most important figures, as tiles.
[[nodiscard]] std::string headline(const RunFigures& figures);
/// The result table, one row per victim.
[[nodiscard]] std::string result_table(const RunFigures& figures);
/// The figures of naturalness, field and mesh.
[[nodiscard]] std::string quality_list(const RunFigures& figures);

}  // namespace tt3d::report
