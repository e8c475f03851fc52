#include <charconv>
#include <cmath>
#include <limits>

#include "mtl_library.h"
#include "obj_text.h"

// OBJ: http://paulbourke.net/dataformats/obj/. Only polygons, uvs and colours are read; normals,
// groups, curves and smoothing are skipped.

namespace tt3d::asset {
namespace fs = std::filesystem;

namespace {

constexpr size_t kMaxElements = size_t{1} << 28;

class ObjReader {
 public:
  explicit ObjReader(const fs::path& path)
      : path_(path), text_(read_part(path, source_.files)), lines_(text_), library_(path, source_) {
    source_.path = path;
    if (is_utf16(text_)) throw InputError(path, "is UTF-16 text; save it as UTF-8");
  }

  AssetSource read() {
    for (std::string line; lines_.next(line);) {
      Words words(line);
      const std::string key = words.keyword();
      if (key == "v") read_vertex(words);
      if (key == "vt") read_uv(words);
      if (key == "f" || key == "fo") read_face(words);
      if (key == "mtllib") library_.add(words.rest());
      if (key == "usemtl") {
        wanted_ = words.rest();
        wanted_line_ = lines_.number();
        material_ = -1;
      }
    }
    if (source_.faces.empty()) throw InputError(path_, "contains no faces");
    finish_colours();
    if (lacks_uvs_) {
      source_.notes.insert(path_.string() +
                           ": faces without vt have a texture; they get its first colour");
    }
    return std::move(source_);
  }

 private:
  [[noreturn]] void fail(const std::string& expected) const {
    throw InputError(path_, lines_.number(), "expected " + expected);
  }

  /// "v x y z", optionally followed by a weight or a colour.
  void read_vertex(Words& words) {
    std::array<double, 3> position{};
    for (double& p : position) {
      const auto value = words.number();
      if (!value || std::abs(*value) > std::numeric_limits<float>::max()) {
        fail("v and three finite numbers");
      }
      p = *value;
    }
    const auto r = words.number(), g = words.number(), b = words.number();
    if (r && g && b) {
      // Vertices before the first coloured one have no colour.
      source_.colours.resize(source_.positions.size(), {-1, -1, -1});
      source_.colours.push_back(
          {static_cast<float>(*r), static_cast<float>(*g), static_cast<float>(*b)});
    } else if (!source_.colours.empty()) {
      source_.colours.push_back({-1, -1, -1});
    }
    source_.positions.push_back(position);
    if (source_.positions.size() > kMaxElements) fail("fewer vertices");
  }

  void read_uv(Words& words) {
    const auto u = words.number();
    const bool only_u = without_comment(words.rest()).empty();
    const auto v = only_u ? std::optional(0.0) : words.number();
    constexpr double kMost = std::numeric_limits<float>::max();
    if (!u || !v || std::abs(*u) > kMost || std::abs(*v) > kMost) fail("vt and two finite numbers");
    source_.uvs.push_back({static_cast<float>(*u), 1 - static_cast<float>(*v)});
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

  void read_face(Words& words) {
    std::vector<std::array<int32_t, 2>> corners;
    for (std::string_view word = words.next(); !word.empty(); word = words.next()) {
      if (word.starts_with('#')) break;
      const size_t slash = std::min(word.find('/'), word.size());
      std::array<int32_t, 2> corner = {read_index(word.substr(0, slash), source_.positions.size()),
                                       -1};
      const std::string_view rest = word.substr(std::min(slash + 1, word.size()));
      const std::string_view uv = rest.substr(0, rest.find('/'));
      if (!uv.empty()) corner[1] = read_index(uv, source_.uvs.size());
      corners.push_back(corner);
    }
    if (corners.size() < 3) fail("at least three corners in the face");
    if (material_ < 0) use_material();
    if (corners.size() == 3) return add_triangle(corners, {0, 1, 2});
    std::vector<std::array<double, 3>> points;
    points.reserve(corners.size());
    for (const auto& [vertex, uv] : corners) {
      points.push_back(source_.positions[static_cast<size_t>(vertex)]);
    }
    const auto triangles = triangulate(points);
    if (!triangles) {
      fail("a concave face of at most " + std::to_string(kMaxConcaveCorners) +
           " corners; split the face into triangles");
    }
    for (const auto& triangle : *triangles) add_triangle(corners, triangle);
  }

  void add_triangle(const std::vector<std::array<int32_t, 2>>& corners,
                    const std::array<size_t, 3>& triangle) {
    SourceFace face;
    for (size_t k = 0; k < 3; ++k) {
      face.vertices[k] = corners[triangle[k]][0];
      face.uvs[k] = corners[triangle[k]][1];
    }
    face.material = material_;
    source_.faces.push_back(face);
    const bool has_uvs = face.uvs[0] >= 0 && face.uvs[1] >= 0 && face.uvs[2] >= 0;
    if (!has_uvs && source_.materials[static_cast<size_t>(material_)].image.defined()) {
      lacks_uvs_ = true;
    }
  }

  /// Makes the material of the last `usemtl` statement the current one.
  void use_material() {
    const MtlMaterial* found = wanted_.empty() ? nullptr : library_.find(wanted_);
    if (found == nullptr && !plain_name(wanted_).empty()) {
      // This names the missing file if there is one.
      if (!library_.missing().empty()) (void)resolve_reference(path_, library_.missing());
      throw InputError(
          path_, wanted_line_,
          "material '" + wanted_ + "' is in no mtllib; add its MTL file or remove the usemtl");
    }
    const auto [entry, fresh] =
        used_.try_emplace(found, static_cast<int32_t>(source_.materials.size()));
    material_ = entry->second;
    if (fresh) source_.materials.push_back(found ? library_.load(*found) : SourceMaterial{});
  }

  /// Gives the faces their colours. Some programs write colours from 0 to 255.
  void finish_colours() {
    if (source_.colours.empty()) return;
    float most = 0;
    for (const auto& colour : source_.colours) {
      most = std::max({most, colour[0], colour[1], colour[2]});
    }
    if (most > 2) {
      for (auto& colour : source_.colours) {
        for (float& channel : colour) channel /= 255.F;
      }
    }
    for (SourceFace& face : source_.faces) {
      const bool coloured = std::all_of(face.vertices.begin(), face.vertices.end(), [&](int32_t v) {
        return source_.colours[static_cast<size_t>(v)][0] >= 0;
      });
      if (coloured) face.colours = face.vertices;
    }
  }

  fs::path path_;
  AssetSource source_;  ///< the members below read into it
  std::string text_;
  Lines lines_;
  MtlLibrary library_;
  std::map<const MtlMaterial*, int32_t> used_;
  std::string wanted_;  ///< the name in the last `usemtl` statement, and its line
  long wanted_line_ = 0;
  int32_t material_ = -1;
  bool lacks_uvs_ = false;  ///< a face has a texture, but not its coordinates
};

}  // namespace

AssetSource read_obj(const fs::path& path) { return ObjReader(path).read(); }

}  // namespace tt3d::asset
