#include "split.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "tt3d/input_files.h"

namespace tt3d::capture {
namespace fs = std::filesystem;

namespace {

constexpr size_t kTestEvery = 8;

/// Equal up to rounding; NaN stands for "not given".
bool same_number(double a, double b) {
  return (std::isnan(a) && std::isnan(b)) || std::abs(a - b) <= 1e-6 * (1 + std::abs(a));
}

bool same_camera(const RawView& a, const RawView& b) {
  const auto numbers = [](const RawView& view) {
    const scene::Camera& c = view.camera;
    const Distortion& d = view.distortion;
    std::vector<double> all(c.camera_to_world.begin(), c.camera_to_world.end());
    all.insert(all.end(), {c.fx, c.fy, c.cx, c.cy, view.angle_x, view.angle_y, d.k1, d.k2, d.p1,
                           d.p2, static_cast<double>(c.width), static_cast<double>(c.height)});
    return all;
  };
  const std::vector<double> first = numbers(a), second = numbers(b);
  return std::equal(first.begin(), first.end(), second.begin(), same_number);
}

/// The file itself, whatever path leads to it.
fs::path identity(const fs::path& path) {
  std::error_code error;
  const fs::path real = fs::canonical(path, error);
  return error ? path : real;
}

/// Finds the view that an entry of a list means.
class ViewNames {
 public:
  explicit ViewNames(const std::vector<RawView>& views) : views_(views) {
    for (size_t i = 0; i < views.size(); ++i) {
      const fs::path name = lower_case(views[i].name);
      paths_[name.generic_string()].insert(i);
      paths_[without_extension(name)].insert(i);
      bare_[name.filename().string()].insert(i);
      bare_[without_extension(name.filename())].insert(i);
    }
  }

  /// The index of the view that has this path, or this name if `entry` is without a folder.
  [[nodiscard]] size_t find(const std::string& entry, const std::string& where) const {
    const std::string name = with_forward_slashes(entry);
    const std::string path = fs::path(name).lexically_normal().generic_string();
    for (size_t i = 0; i < views_.size(); ++i) {
      if (views_[i].name == path) return i;
    }
    std::set<size_t> found = look_up(paths_, path);
    if (found.empty() && path.find('/') == path.npos) found = look_up(bare_, path);
    if (found.size() == 1) return *found.begin();
    if (found.empty()) throw InputError(where + ": no frame has the file_path '" + entry + "'");
    throw InputError(where + ": '" + entry + "' may be " + views_[*found.begin()].name + " or " +
                     views_[*found.rbegin()].name + "; write the file_path of the frame");
  }

 private:
  using Index = std::map<std::string, std::set<size_t>>;

  static std::set<size_t> look_up(const Index& index, const std::string& name) {
    const auto found = index.find(lower_case(name));
    return found == index.end() ? std::set<size_t>() : found->second;
  }

  const std::vector<RawView>& views_;
  Index paths_, bare_;
};

std::set<size_t> indices_of(const ViewNames& names, const std::vector<std::string>& list,
                            const std::string& where) {
  std::set<size_t> indices;
  for (const std::string& entry : list) indices.insert(names.find(entry, where));
  return indices;
}

std::vector<RawView> chosen(const std::vector<RawView>& views, const std::set<size_t>& indices) {
  std::vector<RawView> out;
  out.reserve(indices.size());
  for (const size_t i : indices) out.push_back(views[i]);
  return out;
}

/// The indices below `count` that are in none of the sets.
std::set<size_t> others(size_t count, const std::set<size_t>& a, const std::set<size_t>& b,
                        const std::set<size_t>& c) {
  std::set<size_t> rest;
  for (size_t i = 0; i < count; ++i) {
    if (!a.contains(i) && !b.contains(i) && !c.contains(i)) rest.insert(i);
  }
  return rest;
}

}  // namespace

void drop_repeats(std::vector<RawView>& views, std::vector<std::string>& notes) {
  std::map<fs::path, size_t> first;
  std::vector<RawView> kept;
  std::string example;
  for (RawView& view : views) {
    const auto [at, fresh] = first.emplace(identity(view.image), kept.size());
    if (fresh) {
      kept.push_back(std::move(view));
      continue;
    }
    if (!same_camera(kept[at->second], view)) {
      throw InputError(view.where + ": names " + view.name + ", as " + kept[at->second].where +
                       " does, but with another camera; remove one of them");
    }
    example = view.name;
  }
  if (kept.size() < views.size()) {
    notes.push_back("repeated views with the same picture and camera are read once: " +
                    std::to_string(views.size() - kept.size()) + ", for example " + example);
  }
  views = std::move(kept);
}

void split_by_lists(RawCapture& capture, const SplitLists& lists, const fs::path& file) {
  const std::vector<RawView> all = capture.train;
  const ViewNames names(all);
  const auto train = indices_of(names, lists.train, file.string() + ": train_filenames");
  const auto val = indices_of(names, lists.val, file.string() + ": val_filenames");
  const auto test = indices_of(names, lists.test, file.string() + ": test_filenames");
  for (const size_t i : train) {
    if (!val.contains(i) && !test.contains(i)) continue;
    throw InputError(file, "train_filenames and " + std::string(test.contains(i) ? "test" : "val") +
                               "_filenames both name " + all[i].name +
                               "; remove it from one of them");
  }
  const std::set<size_t> unlisted = others(all.size(), train, val, test);
  capture.train = chosen(all, train.empty() ? unlisted : train);
  capture.test = chosen(all, test.empty() ? val : test);
  if (train.empty() || unlisted.empty()) return;
  // Only train_filenames: the other frames are kept out of training, so they can be test views.
  if (capture.test.empty()) {
    capture.test = chosen(all, unlisted);
    return;
  }
  capture.notes.push_back(std::to_string(unlisted.size()) + " of " + std::to_string(all.size()) +
                          " frames are in none of the lists of file names and are not used");
}

void split_off_test(RawCapture& capture) {
  if (!capture.test.empty() || capture.train.size() < 2) return;
  std::vector<RawView> train;
  for (size_t i = 0; i < capture.train.size(); ++i) {
    (i % kTestEvery == 0 ? capture.test : train).push_back(std::move(capture.train[i]));
  }
  capture.train = std::move(train);
}

void check_disjoint(const RawCapture& capture) {
  std::map<fs::path, const RawView*> trained;
  for (const RawView& view : capture.train) trained.emplace(identity(view.image), &view);
  for (const RawView& view : capture.test) {
    const auto found = trained.find(identity(view.image));
    if (found == trained.end()) continue;
    throw InputError(view.where + ": the test view " + view.name + " is also a training view, " +
                     found->second->where + "; remove one of them");
  }
}

}  // namespace tt3d::capture
