// Any bytes as an archive: every entry is read, or rejected with Malformed.

#include <string>

#include "archive.h"
#include "malformed.h"
#include "memory_file.h"

using tt3d::model::Archive;
using tt3d::model::Malformed;
using tt3d::model::MappedFile;

namespace {

tt3d::model::ModelLimits small_limits() {
  tt3d::model::ModelLimits limits;
  limits.archive_bytes = 1 << 20;
  limits.nodes = 1000;
  return limits;
}

void read_entry(const Archive& archive, const std::string& name) {
  if (!archive.has(name)) return;
  const auto mapped = archive.mapped(name);
  const std::string copy = archive.text(name);
  // Both ways to read an entry must give the same bytes.
  if (mapped && *mapped != copy) __builtin_trap();
}

void read_all(const Archive& archive) {
  for (const char* name : {"archive_format", "byteorder", "data/weights/weight_0", "large"}) {
    read_entry(archive, name);
  }
  (void)archive.json("models/" + archive.model_name() + ".json");
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  const tt3d::testing::MemoryFile file(data, size);
  const tt3d::model::ModelLimits limits = small_limits();
  try {
    read_all(Archive(MappedFile::open(file.path(), limits.archive_bytes), limits));
  } catch (const Malformed&) {
    return 0;
  }
  return 0;
}
