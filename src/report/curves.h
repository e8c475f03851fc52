#pragma once

#include <string>

namespace tt3d::report {

/// The attack's curves as charts: loss, success, regularisers. `csv` has a header line and numbers;
/// columns that are absent leave their line out. "" for an empty text.
[[nodiscard]] std::string curve_charts(const std::string& csv);

}  // namespace tt3d::report
