#pragma once

#include <optional>
#include <string>

#include "tt3d/record.h"

namespace tt3d::report {

/// Time and peak memory of each stage, as a table; "" without stages.
[[nodiscard]] std::string stage_table(const std::vector<record::StageRecord>& stages);

/// Seed, versions and input hashes, as a list.
[[nodiscard]] std::string provenance(const std::optional<record::RunRecord>& run,
                                     const std::optional<record::EvaluationRecord>& evaluation);

}  // namespace tt3d::report
