#include "mtl_library.h"

#include <ATen/ATen.h>

#include <algorithm>

#include "obj_text.h"

namespace tt3d::asset {
namespace fs = std::filesystem;

namespace {

/// The options of a picture statement that tt3d applies.
struct MapOptions {
  std::array<double, 2> scale{1, 1}, offset{0, 0};
  bool clamp = false;
};

/// Options with a fixed number of arguments, which are skipped.
const std::map<std::string, int>& skipped_options() {
  static const std::map<std::string, int> options = {
      {"-blendu", 1}, {"-blendv", 1},  {"-bm", 1}, {"-boost", 1}, {"-cc", 1},    {"-colorspace", 1},
      {"-mm", 2},     {"-imfchan", 1}, {"-t", 0},  {"-type", 1},  {"-texres", 1}};
  return options;
}

/// Reads one to three numbers; fewer than two leave the second value as it is.
void read_vector(Words& words, std::array<double, 2>& values) {
  for (size_t i = 0; i < 3; ++i) {
    Words ahead = words;
    const auto value = ahead.number();
    // The last word of the statement is the file, even if its name is a number.
    if (!value || (i < 2 && ahead.rest().empty())) return;
    if (i < 2) values[i] = *value;
    words = ahead;
  }
}

/// Takes the options off a picture statement; the file's name stays in `words`.
MapOptions take_options(Words& words) {
  MapOptions options;
  std::array<double, 2> unused{};
  for (Words ahead = words; words.rest().starts_with('-'); ahead = words) {
    const std::string option = ahead.keyword();
    const auto skipped = skipped_options().find(option);
    if (option == "-s") {
      read_vector(ahead, options.scale);
    } else if (option == "-o") {
      read_vector(ahead, options.offset);
    } else if (option == "-clamp") {
      options.clamp = ahead.keyword() == "on";
    } else if (skipped == skipped_options().end()) {
      break;  // a file name that begins with a hyphen
    } else {
      for (int i = 0; i < skipped->second; ++i) ahead.next();
      if (option == "-t") read_vector(ahead, unused);
    }
    words = ahead;
  }
  return options;
}

/// "r g b", or "r" for grey.
std::optional<std::array<float, 3>> read_colour(Words& words) {
  const auto r = words.number();
  const bool grey = without_comment(words.rest()).empty();
  const auto g = grey ? r : words.number(), b = grey ? r : words.number();
  if (!r || !g || !b) return std::nullopt;
  return std::array{static_cast<float>(*r), static_cast<float>(*g), static_cast<float>(*b)};
}

/// True for names such as "red #2", which is not "red #1"; "red # of wood" is "red" with a comment.
bool has_number(std::string_view name) {
  const size_t mark = without_comment(name).size();
  return mark + 1 < name.size() && name[mark + 1] != ' ' && name[mark + 1] != '\t';
}

bool is_black(const std::array<float, 3>& colour) {
  return std::all_of(colour.begin(), colour.end(), [](float c) { return c <= 0; });
}

}  // namespace

MtlLibrary::File MtlLibrary::read_file_of_materials(const fs::path& path) {
  const std::string text = read_part(path, source_.files);
  if (is_utf16(text)) throw InputError(path, "is UTF-16 text; save it as UTF-8");
  File file;
  Lines lines(text);
  MtlMaterial* current = nullptr;
  for (std::string line; lines.next(line);) {
    Words words(line);
    const std::string key = words.keyword();
    const std::string rest(words.rest());
    if (key == "newmtl") {
      current = &(file.exact[rest] = MtlMaterial{});
      current->name = rest;
      current->file = path;
    }
    if (current == nullptr || plain_name(rest).empty()) continue;
    if (key == "kd") {
      const auto colour = read_colour(words);
      if (!colour) throw InputError(path, lines.number(), "expected Kd and three numbers");
      current->diffuse = *colour;
    }
    if (key == "ke") current->emission = read_colour(words).value_or(current->emission);
    if (key == "map_kd") current->diffuse_map = rest;
    if (key == "map_ke") current->emission_map = rest;
  }
  for (const auto& [name, material] : file.exact) {
    const auto [entry, fresh] = file.plain.try_emplace(plain_name(name), &material);
    if (!fresh) entry->second = nullptr;  // ambiguous
  }
  return file;
}

std::vector<std::string> MtlLibrary::split_files(std::string_view names) const {
  const std::string whole = plain_name(names);
  if (find_reference(obj_, std::string(names))) return {std::string(names)};
  if (whole.empty() || find_reference(obj_, whole)) return {whole};
  // Several names; a name may hold blanks, so the longest one that exists is taken.
  constexpr size_t kMostWords = 64;
  const std::vector<std::string> words = split_names(without_comment(names));
  if (words.size() > kMostWords) return {whole};
  std::vector<std::string> files;
  for (size_t i = 0; i < words.size();) {
    size_t end = i + 1;
    std::string taken = words[i], joined = words[i];
    for (size_t k = i + 1; k < words.size(); ++k) {
      joined += " " + words[k];
      if (find_reference(obj_, joined)) taken = joined, end = k + 1;
    }
    files.push_back(taken);
    i = end;
  }
  const bool any = std::any_of(files.begin(), files.end(), [&](const std::string& file) {
    return find_reference(obj_, file).has_value();
  });
  return any ? files : std::vector{whole};
}

void MtlLibrary::add(std::string_view names) {
  std::vector<const File*> statement;
  for (const std::string& name : split_files(names)) {
    if (name.empty()) continue;
    const auto path = find_reference(obj_, name);
    if (!path) {
      if (missing_.empty()) missing_ = name;
      continue;
    }
    auto entry = files_.find(*path);
    if (entry == files_.end()) entry = files_.emplace(*path, read_file_of_materials(*path)).first;
    statement.push_back(&entry->second);
  }
  for (const File* file : statement) std::erase(order_, file);
  order_.insert(order_.begin(), statement.begin(), statement.end());
}

const MtlMaterial* MtlLibrary::find(std::string_view name) const {
  for (const File* file : order_) {
    const auto found = file->exact.find(name);
    if (found != file->exact.end()) return &found->second;
  }
  const std::string plain = plain_name(name);
  for (const File* file : order_) {
    const auto found = file->plain.find(plain);
    if (found == file->plain.end() || found->second == nullptr) continue;
    if (!has_number(name) || !has_number(found->second->name)) return found->second;
  }
  return nullptr;
}

fs::path MtlLibrary::find_picture(const MtlMaterial& material, std::string_view name) const {
  for (const std::string& candidate : {std::string(name), plain_name(name)}) {
    for (const fs::path& beside : {material.file, obj_}) {
      if (auto found = find_reference(beside, candidate)) return *found;
    }
  }
  return resolve_reference(material.file, plain_name(name));
}

void MtlLibrary::load_map(const MtlMaterial& material, const std::string& map,
                          SourceMaterial& result) {
  Words words(map);
  const MapOptions options = take_options(words);
  const std::string_view name = words.rest();
  if (plain_name(name).empty()) return;
  const fs::path path = find_picture(material, name);
  at::Tensor& image = by_path_[path];
  if (!image.defined()) image = pictures_.decode(read_part(path, source_.files), path);
  result.image = image;
  if (options.clamp) result.wrap_u = result.wrap_v = Wrap::kClamp;
  // MTL counts v from the bottom of the picture, SourceMaterial from the top.
  result.uv_scale = options.scale;
  result.uv_offset = {options.offset[0], 1 - options.scale[1] - options.offset[1]};
}

SourceMaterial MtlLibrary::load(const MtlMaterial& material) {
  SourceMaterial result;
  result.name = material.name;
  result.colour = material.diffuse;
  load_map(material, material.diffuse_map, result);
  const bool emits = !material.emission_map.empty() || !is_black(material.emission);
  if (!emits || result.image.defined() || !is_black(material.diffuse)) return result;
  result.colour = material.emission;
  load_map(material, material.emission_map, result);
  source_.notes.insert(material.file.string() + ": material '" + material.name +
                       "' has a black Kd; its emission (Ke, map_Ke) is read as its colour");
  return result;
}

}  // namespace tt3d::asset
