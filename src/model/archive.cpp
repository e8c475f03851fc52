#include "archive.h"

#include <fmt/format.h>
#include <sys/stat.h>
#include <zip.h>

#include "malformed.h"

namespace tt3d::model {
namespace {

/// Deflate of honest weights and JSON stays far below; a bomb is a thousand and more.
constexpr uint64_t kMaxCompressionRatio = 200;

void close_zip(zip* archive) { zip_discard(archive); }

zip* open_zip(const std::filesystem::path& path) {
  int code = 0;
  zip* archive = zip_open(path.c_str(), ZIP_RDONLY | ZIP_CHECKCONS, &code);
  if (archive != nullptr) return archive;
  if (code == ZIP_ER_EXISTS) throw Malformed("an entry is there twice");
  zip_error_t error;
  zip_error_init_with_code(&error, code);
  const std::string reason = zip_error_strerror(&error);
  zip_error_fini(&error);
  throw Malformed(fmt::format(
      "not a readable zip archive ({}); expected a .pt2 file written by torch.export.save",
      reason));
}

void check_entry_name(const std::string& name) {
  if (name.empty() || name.front() == '/' || name.find('\\') != std::string::npos ||
      name.find('\0') != std::string::npos || name.find(':') != std::string::npos) {
    throw Malformed(fmt::format("entry '{}' has a name that is not a plain relative path", name));
  }
  for (size_t start = 0; start <= name.size();) {
    const size_t end = std::min(name.find('/', start), name.size());
    const std::string part = name.substr(start, end - start);
    if (part == ".." || part == ".") {
      throw Malformed(fmt::format("entry '{}' points outside the archive", name));
    }
    start = end + 1;
  }
}

void check_entry_kind(zip* archive, uint64_t index, const std::string& name) {
  zip_uint8_t system = 0;
  zip_uint32_t attributes = 0;
  if (zip_file_get_external_attributes(archive, index, 0, &system, &attributes) != 0) return;
  if (system != ZIP_OPSYS_UNIX) return;
  const mode_t type = static_cast<mode_t>(attributes >> 16) & S_IFMT;
  if (type != 0 && type != S_IFREG && type != S_IFDIR) {
    throw Malformed(fmt::format("entry '{}' is a link or device, expected a plain file", name));
  }
}

void check_entry_size(const zip_stat_t& stat, const std::string& name) {
  constexpr zip_uint64_t kNeeded = ZIP_STAT_SIZE | ZIP_STAT_COMP_SIZE | ZIP_STAT_COMP_METHOD;
  if ((stat.valid & kNeeded) != kNeeded) {
    throw Malformed(fmt::format("entry '{}' states no size", name));
  }
  if (stat.comp_method != ZIP_CM_STORE && stat.comp_method != ZIP_CM_DEFLATE) {
    throw Malformed(
        fmt::format("entry '{}' uses compression method {}; only stored and deflated "
                    "entries are read",
                    name, stat.comp_method));
  }
  if ((stat.valid & ZIP_STAT_ENCRYPTION_METHOD) != 0 && stat.encryption_method != ZIP_EM_NONE) {
    throw Malformed(fmt::format("entry '{}' is encrypted", name));
  }
  if (stat.size / kMaxCompressionRatio > stat.comp_size) {
    throw Malformed(fmt::format("entry '{}' unpacks {} bytes to {}: a zip bomb", name,
                                stat.comp_size, stat.size));
  }
}

}  // namespace

Archive::Archive(const std::filesystem::path& path, const ModelLimits& limits)
    : zip_(nullptr, &close_zip), limits_(limits) {
  const auto file_bytes = static_cast<int64_t>(std::filesystem::file_size(path));
  if (file_bytes > limits.archive_bytes) {
    throw Malformed(
        fmt::format("has {} bytes, more than the limit of {}; raise archive_bytes of "
                    "the model limits if you trust it",
                    file_bytes, limits.archive_bytes));
  }
  zip_.reset(open_zip(path));
  list_entries();
  strip_root();
  check_format();
}

void Archive::list_entries() {
  const zip_int64_t count = zip_get_num_entries(zip_.get(), 0);
  if (count > limits_.nodes) {
    throw Malformed(fmt::format("has {} entries, more than the limit of {}", count, limits_.nodes));
  }
  for (zip_int64_t i = 0; i < count; ++i) add_entry(static_cast<uint64_t>(i));
}

void Archive::add_entry(uint64_t index) {
  zip_stat_t stat;
  zip_stat_init(&stat);
  if (zip_stat_index(zip_.get(), index, ZIP_FL_ENC_RAW, &stat) != 0 || stat.name == nullptr) {
    throw Malformed(fmt::format("entry {} cannot be read", index));
  }
  const std::string name = stat.name;
  check_entry_name(name);
  check_entry_kind(zip_.get(), index, name);
  if (name.back() == '/') return;
  check_entry_size(stat, name);
  const auto size = static_cast<int64_t>(stat.size);
  if (size < 0 || size > limits_.archive_bytes - total_bytes_) {
    throw Malformed(
        fmt::format("unpacks to more than the limit of {} bytes; raise archive_bytes "
                    "of the model limits if you trust it",
                    limits_.archive_bytes));
  }
  total_bytes_ += size;
  if (!entries_.emplace(name, Entry{index, size}).second) {
    throw Malformed(fmt::format("entry '{}' is there twice", name));
  }
}

void Archive::strip_root() {
  std::string root;
  std::map<std::string, Entry> stripped;
  for (const auto& [name, entry] : entries_) {
    const size_t slash = name.find('/');
    const std::string folder = name.substr(0, slash == std::string::npos ? 0 : slash + 1);
    if (root.empty()) root = folder;
    if (folder.empty() || folder != root) {
      throw Malformed(
          fmt::format("entry '{}' lies outside the one root folder that "
                      "torch.export.save writes",
                      name));
    }
    stripped.emplace(name.substr(root.size()), entry);
  }
  entries_ = std::move(stripped);
}

void Archive::check_format() const {
  if (!has("archive_format") || !has("archive_version")) {
    const bool pickle = has("data.pkl") || has("constants.pkl");
    throw Malformed(pickle ? "is a pickle (torch.save or TorchScript), which can run code and is "
                             "never read; write it with torch.export.save"
                           : "is not a torch.export archive of torch 2.9 or newer (no "
                             "archive_format); write it with torch.export.save");
  }
  if (text("archive_format") != "pt2") throw Malformed("archive_format is not 'pt2'");
  if (has("byteorder") && text("byteorder") != "little") {
    throw Malformed("was written on a big-endian machine; export it on a little-endian one");
  }
}

int64_t Archive::size(const std::string& name) const {
  const auto found = entries_.find(name);
  if (found == entries_.end()) throw Malformed(fmt::format("has no entry '{}'", name));
  return found->second.size;
}

void Archive::read(const std::string& name, void* target) const {
  const int64_t bytes = size(name);
  const uint64_t index = entries_.at(name).index;
  const std::unique_ptr<zip_file_t, int (*)(zip_file_t*)> file(
      zip_fopen_index(zip_.get(), index, 0), &zip_fclose);
  if (file == nullptr) {
    throw Malformed(fmt::format("entry '{}': {}", name, zip_strerror(zip_.get())));
  }
  auto* out = static_cast<char*>(target);
  int64_t done = 0;
  while (done < bytes) {
    const zip_int64_t got = zip_fread(file.get(), out + done, static_cast<uint64_t>(bytes - done));
    if (got <= 0) {
      throw Malformed(
          fmt::format("entry '{}' is truncated or damaged ({} of {} bytes)", name, done, bytes));
    }
    done += got;
  }
  // The CRC is only compared when the end is reached.
  char beyond = 0;
  if (zip_fread(file.get(), &beyond, 1) != 0) {
    throw Malformed(fmt::format("entry '{}' is damaged (checksum or size)", name));
  }
}

std::string Archive::text(const std::string& name) const {
  std::string content(static_cast<size_t>(size(name)), '\0');
  read(name, content.data());
  return content;
}

nlohmann::json Archive::json(const std::string& name) const {
  using Json = nlohmann::json;
  const std::string content = text(name);
  const auto keep = [&](int depth, Json::parse_event_t event, Json& parsed) {
    if (depth > limits_.json_depth) {
      throw Malformed(fmt::format("entry '{}' is nested deeper than {}", name, limits_.json_depth));
    }
    return event != Json::parse_event_t::key || parsed != "metadata";
  };
  try {
    return Json::parse(content, keep);
  } catch (const Json::exception& error) {
    throw Malformed(fmt::format("entry '{}' is not valid JSON: {}", name, error.what()));
  }
}

std::string Archive::model_name() const {
  const std::string folder = "models/";
  std::string found;
  for (const auto& [name, entry] : entries_) {
    if (name.compare(0, folder.size(), folder) != 0) continue;
    const bool json_file = name.size() > folder.size() + 5 && name.ends_with(".json");
    if (!json_file || !found.empty()) {
      throw Malformed("holds more than one model, expected one graph in models/");
    }
    found = name.substr(folder.size(), name.size() - folder.size() - 5);
  }
  if (found.empty()) throw Malformed("holds no graph (models/model.json)");
  return found;
}

}  // namespace tt3d::model
