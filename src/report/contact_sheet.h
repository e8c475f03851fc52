#pragma once

#include <string>
#include <vector>

#include "tt3d/report.h"

namespace tt3d::report {

/// Views as cards: clean and adversarial picture, and what each victim says to the latter.
[[nodiscard]] std::string contact_sheet(const std::vector<ReportView>& views,
                                        const std::string& target);

/// Captioned pictures.
[[nodiscard]] std::string gallery(const std::vector<ReportImage>& images);

}  // namespace tt3d::report
