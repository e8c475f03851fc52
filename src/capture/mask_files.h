#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "raw_view.h"

namespace tt3d::capture {

/// The mask files of a capture. They lie in the folder `masks` (or `mask`), or beside the pictures.
class MaskFiles {
 public:
  explicit MaskFiles(const std::filesystem::path& folder);

  /// Gives each view its mask file, if it has one and the cameras' file names none. Throws
  /// InputError if two files may be the mask of a picture, if two pictures share a mask, or if
  /// there is a folder of masks but no picture has a mask.
  void assign(std::vector<RawView>& views);

  /// The mask file names that are looked for first, for messages: "masks/a.jpg.png or masks/a.png".
  [[nodiscard]] static std::string expected_names(const RawView& view);

 private:
  /// Picture files by their names in lower case, relative to a folder, without extension.
  using Index = std::map<std::string, std::vector<std::filesystem::path>>;

  void add_folder(const std::filesystem::path& folder);
  [[nodiscard]] std::filesystem::path find(const RawView& view);
  [[nodiscard]] std::filesystem::path find_beside(const RawView& view);

  Index masks_;
  std::map<std::filesystem::path, Index> beside_;  ///< by the folder of the pictures
  std::filesystem::path mask_folder_;              ///< empty: there is none
};

}  // namespace tt3d::capture
