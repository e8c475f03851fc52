#include <fmt/format.h>

#include <algorithm>
#include <cstdlib>
#include <map>

#include "tt3d/input_files.h"
#include "tt3d/model.h"

namespace tt3d::model {
namespace fs = std::filesystem;
namespace {

constexpr const char* kVariable = "TT3D_MODELS";

void add_folder(std::vector<fs::path>& folders, const fs::path& folder) {
  std::error_code error;
  for (const fs::path& known : folders) {
    if (fs::equivalent(known, folder, error)) return;
  }
  folders.push_back(folder);
}

bool looks_like_path(const std::string& model) {
  return model.find('/') != std::string::npos || has_extension(model, {".pt2"});
}

}  // namespace

std::vector<fs::path> model_folders() {
  std::vector<fs::path> folders{"models"};
  const char* variable = std::getenv(kVariable);
  const std::string listed = variable == nullptr ? "" : variable;
  for (size_t start = 0; start < listed.size();) {
    const size_t end = std::min(listed.find(':', start), listed.size());
    if (end > start) add_folder(folders, listed.substr(start, end - start));
    start = end + 1;
  }
  std::error_code error;
  if (fs::is_directory(TT3D_SOURCE_MODELS, error)) add_folder(folders, TT3D_SOURCE_MODELS);
  return folders;
}

std::vector<ModelEntry> list_models() {
  std::map<std::string, fs::path> found;
  for (const fs::path& folder : model_folders()) {
    std::error_code error;
    for (const auto& entry : fs::directory_iterator(folder, error)) {
      const fs::path& path = entry.path();
      if (is_hidden(path) || !has_extension(path, {".pt2"})) continue;
      found.emplace(path.stem().string(), path);
    }
  }
  std::vector<ModelEntry> entries;
  for (const auto& [name, path] : found) entries.push_back({name, path});
  return entries;
}

fs::path find_model(const std::string& model) {
  std::error_code error;
  if (fs::is_regular_file(model, error)) return model;
  if (looks_like_path(model)) throw InputError(model, "no such model file");
  std::vector<std::string> names;
  for (const ModelEntry& entry : list_models()) {
    if (entry.name == model) return entry.path;
    names.push_back(entry.name);
  }
  std::string folders;
  for (const fs::path& folder : model_folders()) {
    folders += (folders.empty() ? "" : ", ") + folder.string();
  }
  const std::string near = nearest_name(model, names);
  throw InputError(fmt::format(
      "model '{}': no {}.pt2 in {}{}; make it with 'python -m tt3d_tools.export {}' or name its "
      "folder in ${}",
      model, model, folders, near.empty() ? "" : ", did you mean '" + near + "'?", model,
      kVariable));
}

}  // namespace tt3d::model
