#pragma once

#include <string>
#include <vector>

#include "html.h"
#include "tt3d/report.h"

/// Tables of the records beside a run's own evaluation. No records give "".
namespace tt3d::report {

/// Success by renderer and background: a row an evaluation, a column a model of `own`.
[[nodiscard]] std::string renderer_table(const Json& own, const std::vector<std::string>& others);

/// What `tt3d judge` found: a row a task and phrase, marked where the phrase is a name of the
/// record's target or true class.
[[nodiscard]] std::string task_table(const std::vector<std::string>& judges, const Json& own);

/// "target" or "true class" where a phrase is a name of the record's, else "".
[[nodiscard]] std::string phrase_role(const std::string& phrase, const Json& own);
/// A judge's task in words.
[[nodiscard]] std::string task_words(const std::string& task);

/// Success in videos: for each a table, a row a model, a column a background label, and the strip
/// of its frames with the answers.
[[nodiscard]] std::string video_parts(const std::vector<ReportVideo>& videos);

/// Distances of the shapes from the first record that has them.
[[nodiscard]] std::string geometry_list(const Json& own, const std::vector<std::string>& others);

}  // namespace tt3d::report
