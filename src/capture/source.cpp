#include <cctype>

#include "raw_view.h"
#include "tt3d/input_files.h"
#include "tt3d/pictures.h"

namespace tt3d::capture {
namespace fs = std::filesystem;

namespace {

constexpr const char* kTrainFile = "transforms_train.json";
constexpr const char* kFramesFile = "transforms.json";

bool is_train_file(const fs::path& path) {
  return path.filename().string().ends_with("_train.json");
}

/// "; found a.json and others, name the file to read it" if the folder has JSON files, else "".
std::string other_json(const fs::path& folder) {
  const std::vector<fs::path> files = list_files(folder, {".json"});
  if (files.empty()) return "";
  return "; to read another JSON file, give its path, for example " + files[0].string();
}

bool holds_pictures(const fs::path& folder) {
  return fs::is_directory(folder) && !image::list_pictures(folder).empty();
}

CaptureFormat detect_format(const fs::path& folder, const fs::path& model) {
  if (fs::exists(folder / kTrainFile)) return CaptureFormat::kNerfSynthetic;
  if (fs::exists(folder / kFramesFile)) return CaptureFormat::kNerfstudio;
  if (!model.empty()) return CaptureFormat::kColmap;
  if (holds_pictures(folder) || holds_pictures(folder / "images")) {
    throw InputError(folder,
                     "contains no capture, but photographs without cameras; find cameras and masks "
                     "with 'tt3d photos " +
                         folder.string() + " --out CAPTURE' and use that folder" +
                         other_json(folder));
  }
  throw InputError(folder,
                   "contains no capture; expected transforms_train.json (NeRF-synthetic), "
                   "transforms.json (nerfstudio) or a COLMAP model in sparse/0" +
                       other_json(folder));
}

/// The folder with the pictures of a COLMAP model: the model's folder, or the nearest one above it
/// that holds `images`.
fs::path folder_of_model(const fs::path& model) {
  constexpr int kLevels = 4;
  fs::path folder = fs::absolute(model).lexically_normal();
  for (int level = 0; level < kLevels; ++level, folder = folder.parent_path()) {
    if (fs::is_directory(folder / "images")) return folder;
  }
  return model;
}

CaptureSource file_source(const CaptureOptions& options) {
  const fs::path& path = options.path;
  const fs::path folder = path.parent_path().empty() ? "." : path.parent_path();
  const bool wants_colmap = options.format == CaptureFormat::kColmap;
  if (has_extension(path, {".json"}) && !wants_colmap) {
    const bool synthetic = options.format == CaptureFormat::kAuto
                               ? is_train_file(path)
                               : options.format == CaptureFormat::kNerfSynthetic;
    return {
        synthetic ? CaptureFormat::kNerfSynthetic : CaptureFormat::kNerfstudio, folder, path, {}};
  }
  const bool colmap = wants_colmap || options.format == CaptureFormat::kAuto;
  if (colmap && has_extension(path, {".bin", ".txt"}) && is_colmap_model(folder)) {
    return {CaptureFormat::kColmap, folder_of_model(folder), folder, {}};
  }
  throw InputError(path,
                   "is not a capture; expected its folder, a JSON file with frames, or "
                   "cameras.bin or .txt of a COLMAP model");
}

/// True for C:/a and for C:a.
bool has_drive_letter(const std::string& path) {
  return path.size() > 1 && path[1] == ':' && std::isalpha(static_cast<unsigned char>(path[0]));
}

}  // namespace

std::string absolute_name(const fs::path& path) {
  return fs::absolute(path).lexically_normal().string();
}

std::string without_extension(fs::path path) { return path.replace_extension().generic_string(); }

CaptureSource find_source(const CaptureOptions& options) {
  if (fs::is_regular_file(options.path)) return file_source(options);
  const fs::path& folder = options.path;
  if (!fs::is_directory(folder)) throw InputError(folder, "no such folder; expected a capture");
  CaptureSource source;
  source.format = options.format;
  source.folder = folder;
  const fs::path model = find_colmap_model(folder, source.notes);
  if (source.format == CaptureFormat::kAuto) source.format = detect_format(folder, model);
  if (source.format == CaptureFormat::kNerfSynthetic) source.cameras = folder / kTrainFile;
  if (source.format == CaptureFormat::kNerfstudio) source.cameras = folder / kFramesFile;
  if (source.format != CaptureFormat::kColmap) {
    source.notes.clear();
    if (options.format == CaptureFormat::kAuto && fs::exists(folder / kTrainFile) &&
        fs::exists(folder / kFramesFile)) {
      source.notes.push_back(folder.string() +
                             ": read transforms_train.json, not "
                             "transforms.json; to read that one, give its path as the capture");
    }
    return source;
  }
  if (model.empty()) {
    throw InputError(folder, "contains no COLMAP model; expected sparse/0/cameras.bin or .txt");
  }
  source.cameras = model;
  if (fs::equivalent(model, folder)) source.folder = folder_of_model(model);
  return source;
}

fs::path path_inside(const fs::path& folder, const std::string& relative,
                     const std::string& where) {
  if (relative.empty()) throw InputError(where + ": expected the path of an image");
  // A backslash is part of the name if there is such a file, else it separates folders.
  std::error_code error;
  const bool literal = relative.find('/') == relative.npos && fs::exists(folder / relative, error);
  const std::string text = literal ? relative : with_forward_slashes(relative);
  fs::path path = fs::path(text).lexically_normal();
  if (path.is_absolute()) {
    const fs::path inside = path.lexically_relative(fs::absolute(folder).lexically_normal());
    if (!inside.empty()) path = inside;
  }
  if (path.is_absolute() || has_drive_letter(text) || *path.begin() == "..") {
    throw InputError(where + ": '" + relative +
                     "' leads out of the capture's folder; expected "
                     "a path relative to and inside " +
                     folder.string());
  }
  return (folder / path).lexically_normal();
}

fs::path find_picture(const fs::path& path) {
  std::error_code error;
  if (fs::is_regular_file(path, error)) return path;
  for (const char* extension : {".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG"}) {
    fs::path candidate = path.string() + extension;
    if (fs::is_regular_file(candidate, error)) return candidate;
  }
  if (!fs::is_directory(path.parent_path(), error)) return {};
  // Windows and macOS do not tell upper case from lower case.
  const std::string wanted = lower_case(path.filename().string());
  fs::path found;
  for (const fs::path& candidate : image::list_pictures(path.parent_path())) {
    if (lower_case(candidate.filename().string()) != wanted &&
        lower_case(candidate.stem().string()) != wanted) {
      continue;
    }
    if (!found.empty()) return {};
    found = candidate;
  }
  return found;
}

}  // namespace tt3d::capture
