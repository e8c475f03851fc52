#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string_view>

namespace tt3d::model {

/// A file as read-only memory, shared by everything that views it. The mapping is private and
/// cannot be written through: an operator that tried would fault, not change a weight. Whoever
/// replaces the file does so by renaming another over it; shortening it in place is not supported.
class MappedFile {
 public:
  /// Throws Malformed for a file that is missing, empty or larger than `limit` bytes.
  static std::shared_ptr<const MappedFile> open(const std::filesystem::path& path, int64_t limit);
  ~MappedFile();
  MappedFile(const MappedFile&) = delete;
  MappedFile& operator=(const MappedFile&) = delete;

  [[nodiscard]] std::string_view bytes() const { return bytes_; }
  /// Gives the memory of a part back: it stays readable, from the file.
  void release(std::string_view part) const;

 private:
  explicit MappedFile(std::string_view bytes) : bytes_(bytes) {}
  std::string_view bytes_;
};

}  // namespace tt3d::model
