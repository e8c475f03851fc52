#pragma once

#include <optional>
#include <string>

#include "tt3d/record.h"

namespace tt3d::report {

/// Shows the views in which the attack fails. Each victim of an evaluation has a plot of its views
/// over azimuth and elevation; hits and misses differ in shape and colour. Its text has the share
/// of hits by octant of azimuth. "" if the record has no answers for single views.
[[nodiscard]] std::string view_spheres(const std::optional<record::EvaluationRecord>& evaluation);

}  // namespace tt3d::report
