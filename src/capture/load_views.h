#pragma once

#include <cstdint>
#include <vector>

#include "raw_view.h"

namespace tt3d::capture {

/// A decoded photograph.
struct LoadedView {
  View view;
  bool masked = false;            ///< it has a mask file or an alpha channel
  bool object_at_border = false;  ///< its mask marks most of the border as object
};

/// Decodes all photographs on a few threads, undistorts them and limits their size. Throws
/// ResourceError if the stages that train on them would need more than `free_bytes`. If several
/// photographs fail, throws the error of the first one in order.
[[nodiscard]] std::vector<LoadedView> load_views(const std::vector<RawView>& raw, int max_size,
                                                 int64_t free_bytes, Progress& progress);

}  // namespace tt3d::capture
