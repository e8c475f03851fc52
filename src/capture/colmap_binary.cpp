#include <bit>
#include <cstring>

#include "colmap.h"
#include "tt3d/linear.h"

namespace tt3d::capture {
namespace fs = std::filesystem;

namespace {

static_assert(std::endian::native == std::endian::little, "COLMAP files are little-endian");

/// Reads values from the front of a file's bytes; every read is checked.
class ByteReader {
 public:
  explicit ByteReader(const fs::path& path) : path_(path), bytes_(read_file(path)) {
    if (bytes_.empty()) throw InputError(path_, "the file is empty");
  }

  template <typename T>
  T take() {
    T value;
    need(sizeof value);
    std::memcpy(&value, bytes_.data() + position_, sizeof value);
    position_ += sizeof value;
    return value;
  }

  /// Reads the number of records that follow, each of at least `record` bytes.
  uint64_t take_count(size_t record) {
    const auto count = take<uint64_t>();
    if (count > (bytes_.size() - position_) / record) fail();
    return count;
  }

  std::string take_text() {
    const size_t end = bytes_.find('\0', position_);
    if (end == std::string::npos) fail();
    std::string text = bytes_.substr(position_, end - position_);
    position_ = end + 1;
    return text;
  }

  /// Throws InputError if bytes follow the last record.
  void check_end() const {
    if (position_ == bytes_.size()) return;
    throw InputError(path_, "has " + std::to_string(bytes_.size() - position_) +
                                " bytes after the records that it counts; expected a COLMAP "
                                "binary model");
  }

  void skip(size_t size) {
    need(size);
    position_ += size;
  }

 private:
  void need(size_t size) const {
    if (size > bytes_.size() - position_) fail();
  }
  [[noreturn]] void fail() const {
    throw InputError(path_, "is truncated or corrupt at byte " + std::to_string(position_) +
                                "; expected a COLMAP binary model");
  }

  fs::path path_;
  std::string bytes_;
  size_t position_ = 0;
};

void read_binary_cameras(const fs::path& path, ColmapModel& model) {
  ByteReader reader(path);
  const uint64_t count = reader.take_count(24);
  for (uint64_t i = 0; i < count; ++i) {
    const int64_t id = reader.take<int32_t>();
    ColmapCamera camera;
    camera.model = reader.take<int32_t>();
    camera.width = static_cast<int64_t>(reader.take<uint64_t>());
    camera.height = static_cast<int64_t>(reader.take<uint64_t>());
    const ColmapLens* lens = colmap_lens(camera.model);
    if (lens == nullptr) {
      throw InputError(path, "camera " + std::to_string(id) + " has the unknown lens model " +
                                 std::to_string(camera.model));
    }
    for (size_t p = 0; p < lens->parameters; ++p) {
      camera.parameters.push_back(reader.take<double>());
    }
    if (!model.cameras.emplace(id, std::move(camera)).second) {
      throw InputError(path, "defines camera " + std::to_string(id) + " twice");
    }
  }
  reader.check_end();
}

void read_binary_images(const fs::path& path, ColmapModel& model) {
  constexpr size_t kPointBytes = 24;
  ByteReader reader(path);
  const uint64_t count = reader.take_count(64);
  for (uint64_t i = 0; i < count; ++i) {
    ColmapImage image;
    image.where = path.string() + ": image " + std::to_string(reader.take<int32_t>());
    for (double& q : image.rotation) q = reader.take<double>();
    for (double& t : image.translation) t = reader.take<double>();
    image.camera = reader.take<int32_t>();
    image.name = reader.take_text();
    const uint64_t points = reader.take_count(kPointBytes);
    reader.skip(points * kPointBytes);
    model.images.push_back(std::move(image));
  }
  reader.check_end();
}

void read_binary_points(const fs::path& path, ColmapModel& model) {
  constexpr size_t kTrackBytes = 8;
  ByteReader reader(path);
  const uint64_t count = reader.take_count(43);
  for (uint64_t i = 0; i < count; ++i) {
    reader.skip(sizeof(uint64_t));
    scene::linear::Vec3 point;
    for (double& p : point) p = reader.take<double>();
    model.points.push_back(point);
    reader.skip(3 + sizeof(double));
    const uint64_t track = reader.take_count(kTrackBytes);
    reader.skip(track * kTrackBytes);
  }
  reader.check_end();
}

}  // namespace

ColmapModel read_colmap_binary(const fs::path& folder) {
  ColmapModel model;
  model.files = {folder / "cameras.bin", folder / "images.bin"};
  read_binary_cameras(model.files[0], model);
  read_binary_images(model.files[1], model);
  if (fs::exists(folder / "points3D.bin")) read_binary_points(folder / "points3D.bin", model);
  return model;
}

}  // namespace tt3d::capture
