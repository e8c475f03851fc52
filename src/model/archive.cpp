#include "archive.h"

#include <fmt/format.h>
#include <sys/stat.h>
#include <zip.h>
#include <zlib.h>

#include <algorithm>
#include <cstring>

#include "malformed.h"

namespace tt3d::model {
namespace {

/// Weights and JSON deflate to far less than this ratio; a zip bomb reaches a thousand and more.
constexpr uint64_t kMaxCompressionRatio = 200;

void close_zip(zip* archive) { zip_discard(archive); }

[[noreturn]] void throw_unreadable(zip_error_t& error) {
  const bool twice = zip_error_code_zip(&error) == ZIP_ER_EXISTS;
  const std::string reason = zip_error_strerror(&error);
  zip_error_fini(&error);
  if (twice) throw Malformed("an entry appears twice");
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
    throw Malformed(fmt::format("entry '{}' does not state its size", name));
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

/// libzip's access to the mapped file. It records where the last read began: this locates an
/// entry's data without parsing zip headers.
struct Archive::Source {
  explicit Source(std::string_view file_bytes) : bytes(file_bytes) { zip_error_init(&error); }
  ~Source() { zip_error_fini(&error); }
  Source(const Source&) = delete;
  Source& operator=(const Source&) = delete;

  static zip_int64_t handle(void* self, void* data, zip_uint64_t length, zip_source_cmd_t command);
  zip_int64_t read(void* data, zip_uint64_t length);
  zip_int64_t seek(void* data, zip_uint64_t length);
  zip_int64_t describe(void* data) const;

  std::string_view bytes;
  uint64_t position = 0, last_read = 0;
  zip_error_t error;
};

zip_int64_t Archive::Source::read(void* data, zip_uint64_t length) {
  const uint64_t count = std::min<uint64_t>(length, bytes.size() - position);
  std::memcpy(data, bytes.data() + position, count);
  last_read = position;
  position += count;
  return static_cast<zip_int64_t>(count);
}

zip_int64_t Archive::Source::seek(void* data, zip_uint64_t length) {
  const zip_int64_t target =
      zip_source_seek_compute_offset(position, bytes.size(), data, length, &error);
  if (target < 0) return -1;
  position = static_cast<uint64_t>(target);
  return 0;
}

zip_int64_t Archive::Source::describe(void* data) const {
  auto* stat = static_cast<zip_stat_t*>(data);
  zip_stat_init(stat);
  stat->size = bytes.size();
  stat->valid = ZIP_STAT_SIZE;
  return sizeof(*stat);
}

zip_int64_t Archive::Source::handle(void* self, void* data, zip_uint64_t length,
                                    zip_source_cmd_t command) {
  auto& source = *static_cast<Source*>(self);
  switch (command) {
    case ZIP_SOURCE_OPEN:
      source.position = 0;
      return 0;
    case ZIP_SOURCE_READ:
      return source.read(data, length);
    case ZIP_SOURCE_SEEK:
      return source.seek(data, length);
    case ZIP_SOURCE_TELL:
      return static_cast<zip_int64_t>(source.position);
    case ZIP_SOURCE_STAT:
      return source.describe(data);
    case ZIP_SOURCE_ERROR:
      return zip_error_to_data(&source.error, data, length);
    case ZIP_SOURCE_CLOSE:
    case ZIP_SOURCE_FREE:
      return 0;
    case ZIP_SOURCE_SUPPORTS:
      return zip_source_make_command_bitmap(
          ZIP_SOURCE_OPEN, ZIP_SOURCE_READ, ZIP_SOURCE_CLOSE, ZIP_SOURCE_STAT, ZIP_SOURCE_ERROR,
          ZIP_SOURCE_FREE, ZIP_SOURCE_SEEK, ZIP_SOURCE_TELL, ZIP_SOURCE_SUPPORTS, -1);
    default:
      zip_error_set(&source.error, ZIP_ER_OPNOTSUPP, 0);
      return -1;
  }
}

Archive::Archive(std::shared_ptr<const MappedFile> file, const ModelLimits& limits)
    : file_(std::move(file)),
      source_(std::make_unique<Source>(file_->bytes())),
      zip_(open_zip(), &close_zip),
      limits_(limits) {
  list_entries();
  strip_root();
  check_format();
}

Archive::~Archive() = default;

zip* Archive::open_zip() {
  zip_error_t error;
  zip_error_init(&error);
  zip_source_t* source = zip_source_function_create(&Source::handle, source_.get(), &error);
  if (source == nullptr) throw_unreadable(error);
  zip* archive = zip_open_from_source(source, ZIP_RDONLY | ZIP_CHECKCONS, &error);
  if (archive == nullptr) {
    zip_source_free(source);
    throw_unreadable(error);
  }
  zip_error_fini(&error);
  return archive;
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
  Entry entry{index, size, std::nullopt};
  if (stat.comp_method == ZIP_CM_STORE && (stat.valid & ZIP_STAT_CRC) != 0) {
    entry.stored_crc = stat.crc;
  }
  if (!entries_.emplace(name, entry).second) {
    throw Malformed(fmt::format("entry '{}' appears twice", name));
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
  // libzip compares the CRC only when it reaches the end.
  char beyond = 0;
  if (zip_fread(file.get(), &beyond, 1) != 0) {
    throw Malformed(fmt::format("entry '{}' is damaged (checksum or size)", name));
  }
}

std::optional<std::string_view> Archive::mapped(const std::string& name) const {
  const auto bytes = static_cast<size_t>(size(name));
  const Entry& entry = entries_.at(name);
  if (!entry.stored_crc || bytes == 0) return std::nullopt;
  const std::unique_ptr<zip_file_t, int (*)(zip_file_t*)> file(
      zip_fopen_index(zip_.get(), entry.index, ZIP_FL_COMPRESSED), &zip_fclose);
  char first = 0;
  if (file == nullptr || zip_fread(file.get(), &first, 1) != 1) return std::nullopt;
  const std::string_view whole = file_->bytes();
  if (bytes > whole.size() - source_->last_read) return std::nullopt;
  const std::string_view data = whole.substr(source_->last_read, bytes);
  const auto crc =
      crc32_z(crc32_z(0, nullptr, 0), reinterpret_cast<const Bytef*>(data.data()), data.size());
  if (crc != *entry.stored_crc) return std::nullopt;
  return data;
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
      throw Malformed("contains more than one model, expected one graph in models/");
    }
    found = name.substr(folder.size(), name.size() - folder.size() - 5);
  }
  if (found.empty()) throw Malformed("contains no graph (models/model.json)");
  return found;
}

}  // namespace tt3d::model
