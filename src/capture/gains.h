#pragma once

#include <filesystem>
#include <vector>

#include "load_views.h"
#include "raw_view.h"

namespace tt3d::capture {

/// Evens the exposure and white balance of photographs: multiplies their linear colours by the
/// factors [r,g,b] that gains.json in `folder` lists by picture name, as 'tt3d photos' writes it.
/// Returns false if there is no such file. Throws InputError for a factor out of [0.1, 10].
bool apply_gains(const std::filesystem::path& folder, const std::vector<RawView>& raw,
                 std::vector<LoadedView>& views);

}  // namespace tt3d::capture
