#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string_view>

namespace tt3d::model {

/// A file as read-only memory, shared by all views of it. The mapping is private and read-only: an
/// operator that tried to write would fault, not change a weight. Replace the file by renaming
/// another over it; shortening it in place is not supported.
class MappedFile {
 public:
  /// Throws Malformed if the file is missing, empty or larger than `limit` bytes.
  static std::shared_ptr<const MappedFile> open(const std::filesystem::path& path, int64_t limit);
  ~MappedFile();
  MappedFile(const MappedFile&) = delete;
  MappedFile& operator=(const MappedFile&) = delete;

  [[nodiscard]] std::string_view bytes() const { return bytes_; }
  /// Releases a part's physical memory. It stays readable, from the file.
  void release(std::string_view part) const;

 private:
  explicit MappedFile(std::string_view bytes) : bytes_(bytes) {}
  std::string_view bytes_;
};

}  // namespace tt3d::model
