#pragma once

#include <optional>
#include <string>
#include <vector>

#include "tt3d/record.h"
#include "tt3d/report.h"

/// Tables of the records beside the evaluation of the run. Without records they are "".
namespace tt3d::report {

using OwnEvaluation = std::optional<record::EvaluationRecord>;

/// Success by renderer and background: one row per evaluation, one column per model of `own`.
[[nodiscard]] std::string renderer_table(const OwnEvaluation& own,
                                         const std::vector<record::EvaluationRecord>& others);

/// Results of `tt3d judge`: one row per task and phrase. A badge marks a phrase that is a name of
/// the target or of the true class.
[[nodiscard]] std::string task_table(const std::vector<record::JudgeRecord>& judges,
                                     const OwnEvaluation& own);

/// "target" or "true class" if a phrase is a name of this class of the evaluation, else "".
[[nodiscard]] std::string phrase_role(const std::string& phrase, const OwnEvaluation& own);
/// The task of a judge in words.
[[nodiscard]] std::string task_words(const std::string& task);

/// Success in videos. Each video has a table (one row per model, one column per background label)
/// and the strip of its frames with the answers.
[[nodiscard]] std::string video_parts(const std::vector<ShownVideo>& videos);

/// Distances between the shapes, from the first evaluation that has them.
[[nodiscard]] std::string geometry_list(const OwnEvaluation& own,
                                        const std::vector<record::EvaluationRecord>& others);

}  // namespace tt3d::report
