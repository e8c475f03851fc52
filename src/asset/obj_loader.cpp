#include <charconv>
#include <cmath>
#include <map>
#include <optional>

#include "asset_source.h"

// OBJ and MTL: http://paulbourke.net/dataformats/obj/ and /mtl/. Only triangles, uvs and colours
// are read; normals, groups, curves and smoothing are skipped.

namespace tt3d::asset {
namespace fs = std::filesystem;

namespace {

constexpr size_t kMaxElements = size_t{1} << 28;

/// Iterates over the words of one line.
class Words {
 public:
  explicit Words(std::string_view line) : rest_(line) {}
  /// The next word, empty at the end.
  std::string_view next() {
    skip_blanks();
    const size_t end = std::min(rest_.find_first_of(" \t"), rest_.size());
    const std::string_view word = rest_.substr(0, end);
    rest_.remove_prefix(end);
    return word;
  }
  /// The remaining text, without blanks at either end.
  std::string_view rest() {
    skip_blanks();
    return rest_.substr(0, rest_.find_last_not_of(" \t") + 1);
  }
  std::optional<float> number() {
    const std::string_view word = next();
    float value = 0;
    const char* start = word.data() + (word.starts_with('+') ? 1 : 0);
    const auto result = std::from_chars(start, word.data() + word.size(), value);
    const bool whole = !word.empty() && result.ptr == word.data() + word.size();
    return whole && result.ec == std::errc() ? std::optional(value) : std::nullopt;
  }

 private:
  void skip_blanks() {
    rest_.remove_prefix(std::min(rest_.find_first_not_of(" \t"), rest_.size()));
  }
  std::string_view rest_;
};

/// Iterates over the lines of a text; joins lines that end in a backslash.
class Lines {
 public:
  explicit Lines(std::string_view text) : rest_(text) {}
  bool next(std::string& line) {
    line.clear();
    if (rest_.empty()) return false;
    bool more = true;
    while (more && !rest_.empty()) {
      const size_t end = std::min(rest_.find('\n'), rest_.size());
      line += rest_.substr(0, end);
      rest_.remove_prefix(std::min(end + 1, rest_.size()));
      ++number_;
      if (line.ends_with('\r')) line.pop_back();
      more = line.ends_with('\\');
      if (more) line.back() = ' ';
    }
    return true;
  }
  [[nodiscard]] long number() const { return number_; }

 private:
  std::string_view rest_;
  long number_ = 0;
};

/// The file name in a map statement, after options such as "-s 1 1 1" or "-bm 0.3".
std::string map_name(std::string_view arguments) {
  std::string text(arguments);
  if (!text.starts_with('-')) return text;
  return text.substr(text.find_last_of(" \t") + 1);
}

void read_mtl(const fs::path& path, std::map<std::string, SourceMaterial>& materials) {
  const std::string text = read_part(path);
  Lines lines(text);
  SourceMaterial* current = nullptr;
  for (std::string line; lines.next(line);) {
    Words words(line);
    const std::string_view key = words.next();
    if (key == "newmtl") {
      const std::string name(words.rest());
      current = &(materials[name] = SourceMaterial{});
      current->name = name;
    } else if (current != nullptr && key == "Kd") {
      for (float& channel : current->colour) {
        const auto value = words.number();
        if (!value || !std::isfinite(*value)) {
          throw InputError(path, lines.number(), "expected Kd and three numbers");
        }
        channel = *value;
      }
    } else if (current != nullptr && key == "map_Kd") {
      const fs::path image = resolve_reference(path, map_name(words.rest()));
      current->image = rgb_image(read_part(image), image);
    }
  }
}

class ObjReader {
 public:
  explicit ObjReader(const fs::path& path) : path_(path), text_(read_part(path)), lines_(text_) {
    source_.path = path;
  }

  AssetSource read() {
    for (std::string line; lines_.next(line);) {
      Words words(line);
      const std::string_view key = words.next();
      if (key == "v") read_vertex(words);
      if (key == "vt") read_uv(words);
      if (key == "f") read_face(words);
      if (key == "usemtl") use_material(std::string(words.rest()));
      if (key == "mtllib") read_mtl(resolve_reference(path_, std::string(words.rest())), library_);
    }
    if (source_.faces.empty()) throw InputError(path_, "contains no faces");
    return std::move(source_);
  }

 private:
  [[noreturn]] void fail(const std::string& expected) const {
    throw InputError(path_, lines_.number(), "expected " + expected);
  }

  /// "v x y z", optionally followed by a weight or a colour.
  void read_vertex(Words& words) {
    std::array<float, 3> position{};
    for (float& p : position) {
      const auto value = words.number();
      if (!value || !std::isfinite(*value)) fail("v and three finite numbers");
      p = *value;
    }
    std::array<float, 3> colour{-1, -1, -1};
    const auto r = words.number(), g = words.number(), b = words.number();
    if (r && g && b) colour = {*r, *g, *b};
    source_.positions.push_back(position);
    source_.colours.push_back(colour);
    if (source_.positions.size() > kMaxElements) fail("fewer vertices");
  }

  void read_uv(Words& words) {
    const auto u = words.number(), v = words.number();
    if (!u || !std::isfinite(*u) || (v && !std::isfinite(*v))) fail("vt and two finite numbers");
    source_.uvs.push_back({*u, 1 - v.value_or(0)});
  }

  /// Converts an index that counts from 1 (negative: from the end) to one that counts from 0.
  int32_t read_index(std::string_view text, size_t count) const {
    int64_t value = 0;
    const auto result = std::from_chars(text.data(), text.data() + text.size(), value);
    const bool whole = result.ec == std::errc() && result.ptr == text.data() + text.size();
    if (whole && value < 0) value += static_cast<int64_t>(count) + 1;
    if (!whole || value < 1 || value > static_cast<int64_t>(count)) {
      fail("an index from 1 to " + std::to_string(count) + " in the face, found '" +
           std::string(text) + "'");
    }
    return static_cast<int32_t>(value - 1);
  }

  /// Splits polygons into fans around their first corner.
  void read_face(Words& words) {
    std::vector<std::array<int32_t, 2>> corners;
    for (std::string_view word = words.next(); !word.empty(); word = words.next()) {
      const size_t slash = std::min(word.find('/'), word.size());
      std::array<int32_t, 2> corner = {read_index(word.substr(0, slash), source_.positions.size()),
                                       -1};
      const std::string_view rest = word.substr(std::min(slash + 1, word.size()));
      const std::string_view uv = rest.substr(0, rest.find('/'));
      if (!uv.empty()) corner[1] = read_index(uv, source_.uvs.size());
      corners.push_back(corner);
    }
    if (corners.size() < 3) fail("at least three corners in the face");
    if (material_ < 0) use_material("");
    for (size_t i = 2; i < corners.size(); ++i) {
      SourceFace face;
      face.vertices = {corners[0][0], corners[i - 1][0], corners[i][0]};
      face.uvs = {corners[0][1], corners[i - 1][1], corners[i][1]};
      face.material = material_;
      source_.faces.push_back(face);
    }
  }

  void use_material(const std::string& name) {
    const auto [entry, fresh] = used_.try_emplace(name, std::ssize(source_.materials));
    material_ = entry->second;
    if (!fresh) return;
    const auto found = library_.find(name);
    if (found == library_.end() && !name.empty()) {
      throw InputError(path_, lines_.number(), "material '" + name + "' is in no mtllib");
    }
    source_.materials.push_back(found == library_.end() ? SourceMaterial{} : found->second);
  }

  fs::path path_;
  std::string text_;
  Lines lines_;
  AssetSource source_;
  std::map<std::string, SourceMaterial> library_;
  std::map<std::string, int32_t> used_;
  int32_t material_ = -1;
};

}  // namespace

AssetSource read_obj(const fs::path& path) { return ObjReader(path).read(); }

}  // namespace tt3d::asset
