#include "tt3d/free_memory.h"

#include <algorithm>
#include <fstream>
#include <limits>
#include <string>

namespace tt3d {
namespace {

constexpr int64_t kUnlimited = std::numeric_limits<int64_t>::max();

/// The number at the start of a kernel file, or `otherwise` ("max", no such file).
int64_t number_in(const char* path, int64_t otherwise) {
  int64_t value = 0;
  return std::ifstream(path) >> value ? value : otherwise;
}

int64_t machine_memory() {
  std::ifstream lines("/proc/meminfo");
  std::string key, unit;
  for (int64_t kilobytes = 0; lines >> key >> kilobytes; std::getline(lines, unit)) {
    if (key == "MemAvailable:") return kilobytes * 1024;
  }
  return kUnlimited;
}

int64_t control_group_memory() {
  const int64_t limit = number_in("/sys/fs/cgroup/memory.max", kUnlimited);
  if (limit == kUnlimited) return kUnlimited;
  return std::max<int64_t>(limit - number_in("/sys/fs/cgroup/memory.current", 0), 0);
}

}  // namespace

int64_t free_memory_bytes() { return std::min(machine_memory(), control_group_memory()); }

}  // namespace tt3d
