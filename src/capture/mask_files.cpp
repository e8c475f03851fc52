#include "mask_files.h"

#include "tt3d/input_files.h"
#include "tt3d/pictures.h"

namespace tt3d::capture {
namespace fs = std::filesystem;

namespace {

constexpr const char* kFolders[] = {"masks", "mask"};

/// `name` and all shorter paths at its end: images/a/b.jpg, a/b.jpg, b.jpg.
std::vector<std::string> path_ends(const std::string& name) {
  std::vector<std::string> ends = {name};
  for (size_t slash = name.find('/'); slash != name.npos; slash = name.find('/', slash + 1)) {
    ends.push_back(name.substr(slash + 1));
  }
  return ends;
}

/// The names that a mask of the picture `name` may have, without the mask's own extension.
std::vector<std::string> mask_names(const std::string& name, bool beside) {
  const std::string stem = without_extension(name);
  std::vector<std::string> names;
  if (!beside) names = {name, stem};
  for (const std::string& base : {stem, name}) {
    names.push_back(base + "_mask");
    names.push_back(base + ".mask");
  }
  return names;
}

/// The file of the index with that name, or an empty path.
fs::path only_file(const std::map<std::string, std::vector<fs::path>>& index,
                   const std::string& name, const RawView& view) {
  const auto found = index.find(lower_case(name));
  if (found == index.end()) return {};
  if (found->second.size() > 1) {
    throw InputError(found->second[0], "may be the mask of " + view.name + ", but so may " +
                                           found->second[1].filename().string() +
                                           "; keep one of them");
  }
  return found->second[0];
}

}  // namespace

MaskFiles::MaskFiles(const fs::path& folder) {
  for (const char* name : kFolders) {
    if (!fs::is_directory(folder / name)) continue;
    mask_folder_ = folder / name;
    add_folder(mask_folder_);
  }
}

void MaskFiles::add_folder(const fs::path& folder) {
  std::error_code error;
  const auto follow = fs::directory_options::follow_directory_symlink;
  for (fs::recursive_directory_iterator at(folder, follow, error), end; !error && at != end;
       at.increment(error)) {
    const fs::path& path = at->path();
    std::error_code unreadable;
    if (is_hidden(path)) {
      at.disable_recursion_pending();
    } else if (image::is_picture_name(path) && at->is_regular_file(unreadable)) {
      masks_[lower_case(without_extension(path.lexically_relative(folder)))].push_back(path);
    }
  }
  if (error) throw InputError(folder, "cannot read the folder: " + error.message());
}

fs::path MaskFiles::find_beside(const RawView& view) {
  const fs::path folder = view.image.parent_path();
  const auto [index, fresh] = beside_.try_emplace(folder);
  if (fresh) {
    for (const fs::path& path : image::list_pictures(folder)) {
      index->second[lower_case(without_extension(path.filename()))].push_back(path);
    }
  }
  for (const std::string& name : mask_names(view.image.filename().string(), true)) {
    fs::path mask = only_file(index->second, name, view);
    if (!mask.empty()) return mask;
  }
  return {};
}

fs::path MaskFiles::find(const RawView& view) {
  fs::path beside = find_beside(view);
  if (!beside.empty()) return beside;
  for (const std::string& end : path_ends(view.name)) {
    for (const std::string& name : mask_names(end, false)) {
      fs::path mask = only_file(masks_, name, view);
      if (!mask.empty()) return mask;
    }
  }
  return {};
}

std::string MaskFiles::expected_names(const RawView& view) {
  const std::string file = view.image.filename().string();
  return "masks/" + file + ".png or masks/" + without_extension(file) + ".png";
}

void MaskFiles::assign(std::vector<RawView>& views) {
  std::map<fs::path, const RawView*> owners;
  bool any = false;
  for (RawView& view : views) {
    const bool named = !view.mask.empty();
    if (!named) view.mask = find(view);
    any = any || !view.mask.empty();
    if (named || view.mask.empty()) continue;
    const auto [owner, fresh] = owners.emplace(view.mask, &view);
    if (!fresh) {
      throw InputError(view.mask, "may be the mask of " + owner->second->name + " and of " +
                                      view.name + "; name it masks/" + view.name +
                                      ".png, and the other mask in the same way");
    }
  }
  if (any || mask_folder_.empty() || views.empty()) return;
  throw InputError(mask_folder_, "no file in it is the mask of a picture; for " + views[0].name +
                                     " expected " + expected_names(views[0]) +
                                     "; rename the masks or remove the folder");
}

}  // namespace tt3d::capture
