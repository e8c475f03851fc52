#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>

#include "mapped_file.h"
#include "tt3d/model_card.h"

struct zip;

namespace tt3d::model {

/// A zip file written by torch.export: one root folder, plain files. Opening it checks every entry
/// (name, duplicate, link, size) before any is read. All functions throw Malformed.
class Archive {
 public:
  Archive(std::shared_ptr<const MappedFile> file, const ModelLimits& limits);
  ~Archive();
  Archive(const Archive&) = delete;
  Archive& operator=(const Archive&) = delete;

  /// True if the root folder contains a file of this relative name.
  [[nodiscard]] bool has(const std::string& name) const { return entries_.count(name) != 0; }
  /// Uncompressed size in bytes of a file that must exist.
  [[nodiscard]] int64_t size(const std::string& name) const;
  /// Reads a whole file into `target`, which has size(name) bytes; checks its CRC.
  void read(const std::string& name, void* target) const;
  /// The bytes of a file inside the mapped archive, CRC checked. Nothing if the file is compressed
  /// or damaged; read() then tells which. Valid as long as file() is.
  [[nodiscard]] std::optional<std::string_view> mapped(const std::string& name) const;
  [[nodiscard]] const std::shared_ptr<const MappedFile>& file() const { return file_; }
  /// Reads a text file.
  [[nodiscard]] std::string text(const std::string& name) const;
  /// Reads a JSON file of limited depth; values under keys "metadata" are dropped.
  [[nodiscard]] nlohmann::json json(const std::string& name) const;
  /// The relative name of the only model graph, without folder and ".json".
  [[nodiscard]] std::string model_name() const;

 private:
  struct Entry {
    uint64_t index = 0;
    int64_t size = 0;
    std::optional<uint32_t> stored_crc;  ///< only for uncompressed entries
  };
  struct Source;
  void list_entries();
  void add_entry(uint64_t index);
  void strip_root();
  void check_format() const;

  [[nodiscard]] zip* open_zip();

  std::shared_ptr<const MappedFile> file_;
  std::unique_ptr<Source> source_;  ///< outlives zip_, which reads from it
  std::unique_ptr<zip, void (*)(zip*)> zip_;
  std::map<std::string, Entry> entries_;
  ModelLimits limits_;
  int64_t total_bytes_ = 0;
};

}  // namespace tt3d::model
