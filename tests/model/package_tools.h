#pragma once

#include <zip.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

#include "tt3d/core.h"

/// Packages with one error: unpack a good one, change it, pack it again.
namespace tt3d::testing {

using Entries = std::map<std::string, std::string>;

inline std::filesystem::path fixture(const std::string& name) {
  return std::filesystem::path(TT3D_SOURCE_DIR) / "tests/model/fixtures" / name;
}

/// The path of a toy network.
inline std::string toy(const std::string& name) { return fixture(name + ".pt2").string(); }

inline Entries unpack(const std::filesystem::path& path) {
  Entries entries;
  zip_t* archive = zip_open(path.c_str(), ZIP_RDONLY, nullptr);
  for (zip_int64_t i = 0; i < zip_get_num_entries(archive, 0); ++i) {
    zip_stat_t stat;
    zip_stat_index(archive, static_cast<zip_uint64_t>(i), 0, &stat);
    std::string content(stat.size, '\0');
    zip_file_t* file = zip_fopen_index(archive, static_cast<zip_uint64_t>(i), 0);
    zip_fread(file, content.data(), content.size());
    zip_fclose(file);
    entries[stat.name] = content;
  }
  zip_discard(archive);
  return entries;
}

/// Writes a zip file; `last` may change the open archive, e.g. attributes of entries.
inline void pack(const std::filesystem::path& path, const Entries& entries, bool deflate = false,
                 const std::function<void(zip_t*)>& last = {}) {
  std::filesystem::remove(path);
  zip_t* archive = zip_open(path.c_str(), ZIP_CREATE, nullptr);
  for (const auto& [name, content] : entries) {
    zip_source_t* source = zip_source_buffer(archive, content.data(), content.size(), 0);
    const zip_int64_t index = zip_file_add(archive, name.c_str(), source, 0);
    zip_set_file_compression(archive, static_cast<zip_uint64_t>(index),
                             deflate ? ZIP_CM_DEFLATE : ZIP_CM_STORE, 0);
  }
  if (last) last(archive);
  zip_close(archive);
}

/// The card of a fixture with the checksum of `archive`; `edit` may change it further.
inline void write_card(const std::filesystem::path& archive, const std::string& from,
                       const std::function<void(nlohmann::json&)>& edit = {}) {
  auto card = nlohmann::json::parse(read_file(fixture(from + ".json")));
  card["sha256"] = sha256_file(archive);
  if (edit) edit(card);
  auto path = archive;
  write_file_atomic(path.replace_extension(".json"), card.dump());
}

/// Replaces every `from` by `to`, which has the same length, so that offsets in a zip stay valid.
inline void overwrite(std::string& text, std::string_view from, std::string_view to) {
  for (size_t at = 0; (at = text.find(from, at)) != std::string::npos; at += to.size()) {
    std::copy(to.begin(), to.end(), text.begin() + static_cast<std::ptrdiff_t>(at));
  }
}

}  // namespace tt3d::testing
