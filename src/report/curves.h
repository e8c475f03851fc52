#pragma once

#include <string>

#include "tt3d/record.h"

namespace tt3d::report {

/// The attack's curves as charts: loss, success, regularisers. "" for an empty log.
[[nodiscard]] std::string curve_charts(const record::Curves& curves);

}  // namespace tt3d::report
