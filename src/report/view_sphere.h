#pragma once

#include <string>

#include "html.h"

namespace tt3d::report {

/// For each victim of an evaluation's CSV, its views as points over azimuth and elevation, hits and
/// misses apart in shape and colour, and the share of hits by octant of azimuth: where the attack
/// fails. "" where the CSV or the record has no views.
[[nodiscard]] std::string view_spheres(const std::string& csv, const Json& record);

}  // namespace tt3d::report
