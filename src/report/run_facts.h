#pragma once

#include <string>
#include <vector>

#include "html.h"

namespace tt3d::report {

/// Names of the models the attack saw: attack.surrogates of run.json, else of the TOML text.
/// Paths are reduced to the model's name.
[[nodiscard]] std::vector<std::string> surrogate_names(const Json& run, const std::string& toml);

/// Time and peak memory of each stage, as a table.
[[nodiscard]] std::string stage_table(const Json& run);

/// Seed, versions and input hashes, as a list.
[[nodiscard]] std::string provenance(const Json& run, const Json& record);

}  // namespace tt3d::report
