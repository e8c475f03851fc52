#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "raw_view.h"

namespace tt3d::capture {

/// The lists of file names in a camera file that split its views.
struct SplitLists {
  std::vector<std::string> train, val, test;
};

/// Removes views that repeat an earlier one: the same picture, by whatever path, and the same
/// camera. A line in `notes` says so. Throws InputError if the cameras differ.
void drop_repeats(std::vector<RawView>& views, std::vector<std::string>& notes);

/// Splits the views in capture.train, which come from `file`. Views of `test`, else of `val`, are
/// test views; views that a list keeps out of training are not trained on. Throws InputError for a
/// name that no view or several views have, and for a view that is in `train` and in another list.
void split_by_lists(RawCapture& capture, const SplitLists& lists,
                    const std::filesystem::path& file);

/// Moves every 8th view to `test` if there is no test view and more than one view.
void split_off_test(RawCapture& capture);

/// Throws InputError if a picture is in train and in test.
void check_disjoint(const RawCapture& capture);

}  // namespace tt3d::capture
