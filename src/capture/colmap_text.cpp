#include <sstream>

#include "colmap.h"
#include "tt3d/input_files.h"
#include "tt3d/linear.h"

namespace tt3d::capture {
namespace fs = std::filesystem;

namespace {

/// Returns the lines of a text file that are not comments, with their line numbers.
class LineReader {
 public:
  explicit LineReader(const fs::path& path) : path_(path), stream_(read_text(path)) {}

  bool next() {
    while (std::getline(stream_, line_)) {
      ++number_;
      if (!line_.empty() && line_.back() == '\r') line_.pop_back();
      if (!line_.starts_with('#')) return true;
      read_comment();
    }
    return false;
  }
  /// What the comment "# Number of images: N" says; -1 if there is none.
  [[nodiscard]] int64_t stated_images() const { return stated_images_; }
  [[nodiscard]] bool blank() const { return line_.find_first_not_of(" \t") == std::string::npos; }
  [[nodiscard]] std::istringstream words() const { return std::istringstream(line_); }
  [[nodiscard]] std::string where() const { return path_.string() + ":" + std::to_string(number_); }
  [[noreturn]] void fail(const std::string& expected) const {
    throw InputError(path_, number_, "expected " + expected);
  }

 private:
  void read_comment() {
    constexpr std::string_view kImages = "# Number of images:";
    if (!line_.starts_with(kImages)) return;
    std::istringstream words(line_.substr(kImages.size()));
    if (int64_t number = 0; words >> number) stated_images_ = number;
  }

  fs::path path_;
  std::istringstream stream_;
  std::string line_;
  int64_t stated_images_ = -1;
  long number_ = 0;
};

/// Reads a number like strtod: "nan" is a number here; the pose check rejects it.
bool take_number(std::istringstream& words, double& value) {
  std::string word;
  if (!(words >> word)) return false;
  char* end = nullptr;
  value = std::strtod(word.c_str(), &end);
  return end == word.c_str() + word.size();
}

void read_text_cameras(const fs::path& path, ColmapModel& model) {
  LineReader reader(path);
  while (reader.next()) {
    if (reader.blank()) continue;
    std::istringstream words = reader.words();
    int64_t id = 0;
    std::string lens_name;
    ColmapCamera camera;
    if (!(words >> id >> lens_name >> camera.width >> camera.height)) {
      reader.fail("CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]");
    }
    camera.model = colmap_lens_number(lens_name);
    if (camera.model < 0) reader.fail("a COLMAP lens model, found '" + lens_name + "'");
    camera.parameters.resize(colmap_lens(camera.model)->parameters);
    for (double& p : camera.parameters) {
      if (!take_number(words, p)) {
        reader.fail(std::to_string(camera.parameters.size()) + " parameters for " + lens_name);
      }
    }
    if (std::string rest; words >> rest) {
      reader.fail("only " + std::to_string(camera.parameters.size()) + " parameters for " +
                  lens_name);
    }
    if (!model.cameras.emplace(id, std::move(camera)).second) {
      reader.fail("each CAMERA_ID once, found " + std::to_string(id) + " again");
    }
  }
}

/// True for the second line of an image: X Y POINT3D_ID, any number of times. The first points
/// tell; lines may be long.
bool is_points_line(std::istringstream words) {
  constexpr size_t kEnough = 12;
  double value = 0;
  size_t count = 0;
  while (count < kEnough && !(words >> std::ws).eof()) {
    if (!take_number(words, value)) return false;
    ++count;
  }
  return count % 3 == 0;
}

/// An image has two lines. The second one lists its points; it may be blank, or absent, as some
/// programs drop blank lines.
void read_text_images(const fs::path& path, ColmapModel& model) {
  LineReader reader(path);
  bool points_may_follow = false;
  while (reader.next()) {
    if (reader.blank()) continue;
    if (points_may_follow && is_points_line(reader.words())) {
      points_may_follow = false;
      continue;
    }
    std::istringstream words = reader.words();
    ColmapImage image;
    image.where = reader.where();
    int64_t id = 0;
    bool good = static_cast<bool>(words >> id);
    for (double& q : image.rotation) good = good && take_number(words, q);
    for (double& t : image.translation) good = good && take_number(words, t);
    good = good && words >> image.camera && std::getline(words >> std::ws, image.name);
    if (!good) reader.fail("IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME");
    image.name.erase(image.name.find_last_not_of(" \t") + 1);
    model.images.push_back(std::move(image));
    points_may_follow = true;
  }
  const auto found = static_cast<int64_t>(model.images.size());
  if (reader.stated_images() < 0 || reader.stated_images() == found) return;
  model.notes.push_back(path.string() + ": its comment says " +
                        std::to_string(reader.stated_images()) + " images, but it holds " +
                        std::to_string(found) + "; the file may be incomplete");
}

void read_text_points(const fs::path& path, ColmapModel& model) {
  LineReader reader(path);
  while (reader.next()) {
    if (reader.blank()) continue;
    std::istringstream words = reader.words();
    int64_t id = 0;
    scene::linear::Vec3 point;
    bool good = static_cast<bool>(words >> id);
    for (double& p : point) good = good && take_number(words, p);
    if (!good) reader.fail("POINT3D_ID X Y Z R G B ERROR TRACK[]");
    model.points.push_back(point);
  }
}

}  // namespace

ColmapModel read_colmap_text(const fs::path& folder) {
  ColmapModel model;
  model.files = {folder / "cameras.txt", folder / "images.txt"};
  read_text_cameras(model.files[0], model);
  read_text_images(model.files[1], model);
  if (fs::exists(folder / "points3D.txt")) read_text_points(folder / "points3D.txt", model);
  return model;
}

}  // namespace tt3d::capture
