#include <algorithm>

#include "asset_source.h"
#include "tt3d/core.h"
#include "tt3d/input_files.h"

/// The files that an asset refers to.
namespace tt3d::asset {
namespace fs = std::filesystem;

namespace {

/// True if a reference is empty, absolute, a web address, or leads to a parent folder.
bool leads_out(const std::string& name) {
  const fs::path path = fs::path(name).lexically_normal();
  return path.empty() || path.is_absolute() || *path.begin() == ".." || name.find(':') != name.npos;
}

/// The entry of a folder with this name; else the only one whose name differs in case.
std::optional<fs::path> find_entry(const fs::path& folder, const fs::path& name) {
  std::error_code error;
  if (fs::exists(folder / name, error)) return folder / name;
  const std::string wanted = lower_case(name.string());
  std::optional<fs::path> found;
  for (fs::directory_iterator entry(folder.empty() ? "." : folder, error), end;
       !error && entry != end; entry.increment(error)) {
    if (lower_case(entry->path().filename().string()) != wanted) continue;
    if (found) return std::nullopt;
    found = folder / entry->path().filename();
  }
  return found;
}

/// The file at a relative path below a folder; upper and lower case may differ.
std::optional<fs::path> find_below(const fs::path& folder, const fs::path& relative) {
  std::error_code error;
  if (fs::is_regular_file(folder / relative, error)) return folder / relative;
  fs::path found = folder;
  for (const fs::path& part : relative) {
    const auto entry = find_entry(found, part);
    if (!entry) return std::nullopt;
    found = *entry;
  }
  return fs::is_regular_file(found, error) ? std::optional(found) : std::nullopt;
}

}  // namespace

std::string read_part(const fs::path& path, std::set<fs::path>& files) {
  std::error_code unknown;
  const uintmax_t bytes = fs::file_size(path, unknown);
  if (!unknown && bytes > kMaxPartBytes) {
    throw InputError(path, "has " + std::to_string(bytes >> 20) + " MiB, over the limit of " +
                               std::to_string(kMaxPartBytes >> 20) +
                               "; decimate the mesh or shrink its textures");
  }
  files.insert(path);
  return read_file(path);
}

std::optional<fs::path> find_reference(const fs::path& asset, const std::string& reference) {
  const std::string name = with_forward_slashes(reference);
  const fs::path folder = asset.parent_path();
  if (!leads_out(name)) {
    if (auto found = find_below(folder, fs::path(name).lexically_normal())) return found;
  }
  const fs::path beside = fs::path(name).filename();
  return beside.empty() || leads_out(beside.string()) ? std::nullopt : find_below(folder, beside);
}

fs::path resolve_reference(const fs::path& asset, const std::string& reference) {
  if (const auto found = find_reference(asset, reference)) return *found;
  const std::string name = with_forward_slashes(reference);
  if (leads_out(name)) {
    throw InputError(asset, "refers to '" + reference +
                                "', which leads out of its folder; put "
                                "the file next to the asset and use a relative path");
  }
  throw InputError(asset.parent_path() / fs::path(name).lexically_normal(),
                   "no such file, named by " + asset.string() + "; put it next to that file");
}

}  // namespace tt3d::asset
