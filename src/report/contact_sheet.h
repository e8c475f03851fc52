#pragma once

#include <string>
#include <vector>

#include "tt3d/report.h"

namespace tt3d::report {

/// Views as cards: clean and adversarial picture, and the answer of each victim for the adversarial
/// one.
[[nodiscard]] std::string contact_sheet(const std::vector<ShownView>& views,
                                        const std::string& target);

/// Frames of a video in a scrolling row, with the answer of each victim; `video` is its name as
/// HTML.
[[nodiscard]] std::string frame_strip(const std::vector<ShownFrame>& frames,
                                      const std::string& video, const std::string& target);

}  // namespace tt3d::report
