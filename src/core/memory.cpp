#include "tt3d/memory.h"

#include <sys/resource.h>

#include <algorithm>
#include <cstddef>
#include <cstdlib>
#include <fstream>
#include <limits>
#include <string>

// Present if the program is linked with jemalloc (allocator.cpp).
extern "C" int mallctl(const char* name, void* old, size_t* old_length, void* now, size_t length)
    __attribute__((weak));

namespace tt3d {
namespace {

constexpr int64_t kUnlimited = std::numeric_limits<int64_t>::max();

/// A line "NAME: N kB" of a kernel file, in bytes; `otherwise` if there is none.
int64_t kilobytes_in(const char* path, const std::string& name, int64_t otherwise) {
  std::ifstream lines(path);
  for (std::string line; std::getline(lines, line);) {
    if (line.starts_with(name)) {
      return std::strtoll(line.c_str() + name.size(), nullptr, 10) * 1024;
    }
  }
  return otherwise;
}

/// The number at the start of a kernel file, or `otherwise` ("max", no such file).
int64_t number_in(const char* path, int64_t otherwise) {
  int64_t value = 0;
  return std::ifstream(path) >> value ? value : otherwise;
}

int64_t control_group_memory() {
  const int64_t limit = number_in("/sys/fs/cgroup/memory.max", kUnlimited);
  if (limit == kUnlimited) return kUnlimited;
  return std::max<int64_t>(limit - number_in("/sys/fs/cgroup/memory.current", 0), 0);
}

}  // namespace

int64_t peak_memory_bytes() noexcept {
  // clear_refs resets VmHWM, but not getrusage's figure. The fallback is for systems without /proc.
  const int64_t peak = kilobytes_in("/proc/self/status", "VmHWM:", 0);
  if (peak > 0) return peak;
  rusage usage{};
  ::getrusage(RUSAGE_SELF, &usage);
  return static_cast<int64_t>(usage.ru_maxrss) * 1024;
}

void reset_peak_memory() noexcept { std::ofstream("/proc/self/clear_refs") << "5"; }

int64_t memory_bytes() noexcept { return kilobytes_in("/proc/self/status", "VmRSS:", 0); }

int64_t free_memory_bytes() noexcept {
  return std::min(kilobytes_in("/proc/meminfo", "MemAvailable:", kUnlimited),
                  control_group_memory());
}

void release_freed_memory() noexcept {
  if (mallctl == nullptr) return;
  // 4096 stands for all arenas (MALLCTL_ARENAS_ALL).
  mallctl("thread.tcache.flush", nullptr, nullptr, nullptr, 0);
  mallctl("arena.4096.purge", nullptr, nullptr, nullptr, 0);
}

void MemoryTrimmer::after_step() noexcept {
  constexpr int64_t kSettling = 8;     // by then steps of equal size have all their memory
  constexpr double kAllowed = 1.15;    // growth that is left alone
  constexpr int64_t kNoise = 1 << 25;  // bytes
  const int64_t now = memory_bytes();
  if (++steps_ <= kSettling) {
    largest_ = std::max(largest_, now);
    return;
  }
  const auto bound = static_cast<int64_t>(kAllowed * static_cast<double>(largest_)) + kNoise;
  if (now <= bound) return;
  release_freed_memory();
  steps_ = 0;
  largest_ = std::max(largest_, memory_bytes());
}

}  // namespace tt3d
