#pragma once

#include <string>
#include <vector>

#include "tt3d/report.h"

namespace tt3d::report {

/// Views as cards: clean and adversarial picture, and what each victim says to the latter.
[[nodiscard]] std::string contact_sheet(const std::vector<ReportView>& views,
                                        const std::string& target);

/// Frames of a video in a row that scrolls, with what each victim says; `video` is HTML.
[[nodiscard]] std::string frame_strip(const std::vector<ReportFrame>& frames,
                                      const std::string& video, const std::string& target);

}  // namespace tt3d::report
