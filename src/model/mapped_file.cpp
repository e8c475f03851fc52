#include "mapped_file.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "malformed.h"

namespace tt3d::model {
namespace {

/// Closes a file descriptor at the end of the scope; the mapping stays valid.
struct Descriptor {
  int number;
  ~Descriptor() {
    if (number >= 0) ::close(number);
  }
};

int64_t checked_size(int descriptor, int64_t limit) {
  struct stat status {};
  if (::fstat(descriptor, &status) != 0 || !S_ISREG(status.st_mode)) {
    throw Malformed("is not a plain file");
  }
  const int64_t size = status.st_size;
  if (size == 0) throw Malformed("not a readable zip archive (the file is empty)");
  if (size <= limit) return size;
  throw Malformed(
      fmt::format("has {} bytes, more than the limit of {}; raise archive_bytes of the model "
                  "limits if you trust it",
                  size, limit));
}

}  // namespace

std::shared_ptr<const MappedFile> MappedFile::open(const std::filesystem::path& path,
                                                   int64_t limit) {
  const Descriptor file{::open(path.c_str(), O_RDONLY | O_CLOEXEC)};
  if (file.number < 0) throw Malformed(fmt::format("cannot open: {}", std::strerror(errno)));
  const auto size = static_cast<size_t>(checked_size(file.number, limit));
  void* const start = ::mmap(nullptr, size, PROT_READ, MAP_PRIVATE, file.number, 0);
  if (start == MAP_FAILED) {
    throw Malformed(fmt::format("cannot be mapped into memory: {}", std::strerror(errno)));
  }
  return std::shared_ptr<const MappedFile>(new MappedFile({static_cast<const char*>(start), size}));
}

MappedFile::~MappedFile() { ::munmap(const_cast<char*>(bytes_.data()), bytes_.size()); }

void MappedFile::release(std::string_view part) const {
  const auto page = static_cast<uintptr_t>(::sysconf(_SC_PAGESIZE));
  const auto start = (reinterpret_cast<uintptr_t>(part.data()) + page - 1) / page * page;
  const auto end = reinterpret_cast<uintptr_t>(part.data() + part.size()) / page * page;
  if (end > start) ::madvise(reinterpret_cast<void*>(start), end - start, MADV_DONTNEED);
}

}  // namespace tt3d::model
