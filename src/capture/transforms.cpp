#include <algorithm>
#include <limits>
#include <set>

#include "camera.h"
#include "json_file.h"
#include "raw_view.h"

// transforms.json and its kin: NeRF-synthetic (Mildenhall et al. 2020) has one horizontal field of
// view for all frames and splits by file; nerfstudio and instant-ngp give intrinsics in pixels,
// for all frames or for each, with lens distortion.

namespace tt3d {
namespace fs = std::filesystem;
using nlohmann::json;

namespace {

/// Refuses lens models that are not a pinhole with k1 k2 p1 p2.
void check_lens(const json& object, const std::string& where) {
  static const std::set<std::string> known = {"",       "PINHOLE",       "SIMPLE_PINHOLE",
                                              "OPENCV", "SIMPLE_RADIAL", "RADIAL"};
  const std::string model = json_text(object, "camera_model", where);
  const auto fisheye = object.find("is_fisheye");
  const bool marked = fisheye != object.end() && fisheye->is_boolean() && fisheye->get<bool>();
  if (!known.contains(model) || marked) {
    throw InputError(where + ".camera_model: '" + (marked ? "is_fisheye" : model) +
                     "' is not supported; undistort the images to PINHOLE first, for example "
                     "with colmap image_undistorter");
  }
  for (const char* key : {"k3", "k4", "k5", "k6"}) {
    if (json_number(object, key, 0, where) != 0) {
      throw InputError(where + "." + key +
                       ": only k1, k2, p1 and p2 are supported; undistort "
                       "the images first");
    }
  }
}

int image_side(const json& object, const char* key, int fallback, const std::string& where) {
  const double value = json_number(object, key, fallback, where);
  if (value < 0 || value > 1e6 || value != std::floor(value)) {
    throw InputError(where + "." + key + ": expected a whole number of pixels");
  }
  return static_cast<int>(value);
}

/// Overrides what `view` inherited with the intrinsics that `object` has.
void read_intrinsics(const json& object, const std::string& where, RawView& view) {
  check_lens(object, where);
  Camera& camera = view.camera;
  camera.width = image_side(object, "w", camera.width, where);
  camera.height = image_side(object, "h", camera.height, where);
  view.angle_x = json_number(object, "camera_angle_x", view.angle_x, where);
  view.angle_y = json_number(object, "camera_angle_y", view.angle_y, where);
  camera.fx = json_number(object, "fl_x", camera.fx, where);
  camera.fy = json_number(object, "fl_y", object.contains("fl_x") ? camera.fx : camera.fy, where);
  camera.cx = json_number(object, "cx", camera.cx, where);
  camera.cy = json_number(object, "cy", camera.cy, where);
  view.distortion.k1 = json_number(object, "k1", view.distortion.k1, where);
  view.distortion.k2 = json_number(object, "k2", view.distortion.k2, where);
  view.distortion.p1 = json_number(object, "p1", view.distortion.p1, where);
  view.distortion.p2 = json_number(object, "p2", view.distortion.p2, where);
}

linear::Mat4 read_pose(const json& frame, const std::string& where) {
  const std::string key = where + ".transform_matrix";
  const auto rows = frame.find("transform_matrix");
  const auto wrong = [&] { return InputError(key + ": expected 4 rows of 4 numbers"); };
  if (rows == frame.end() || !rows->is_array() || rows->size() < 3 || rows->size() > 4) {
    throw wrong();
  }
  linear::Mat4 pose{};
  pose[15] = 1;
  for (size_t r = 0; r < rows->size(); ++r) {
    const json& row = (*rows)[r];
    if (!row.is_array() || row.size() != 4) throw wrong();
    for (size_t c = 0; c < 4; ++c) {
      if (!row[c].is_number())
        throw InputError(key + ": row " + std::to_string(r) +
                         " holds something that is not a number");
      pose[4 * r + c] = row[c].get<double>();
    }
  }
  check_pose(pose, key);
  return pose;
}

/// NeRF-synthetic leaves the extension out.
fs::path find_image(const fs::path& path) {
  std::vector<fs::path> candidates = {path};
  for (const char* extension : {".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG"}) {
    candidates.emplace_back(path.string() + extension);
  }
  return first_file(candidates);
}

/// mask_path, else IMAGE_mask.png beside the image, else masks/IMAGE.png in the capture.
fs::path find_mask(const fs::path& folder, const json& frame, const fs::path& image,
                   const std::string& where) {
  const std::string given = json_text(frame, "mask_path", where);
  if (given.empty()) {
    const std::string stem = image.stem().string();
    return first_file(
        {image.parent_path() / (stem + "_mask.png"),
         folder / "masks" / image.lexically_relative(folder).replace_extension(".png"),
         folder / "masks" / (stem + ".png")});
  }
  const fs::path mask = path_inside(folder, given, where + ".mask_path");
  if (!fs::is_regular_file(mask)) throw InputError(mask, "no such mask, named by " + where);
  return mask;
}

RawView read_frame(const fs::path& folder, const json& frame, RawView view,
                   const std::string& where) {
  view.where = where;
  if (!frame.is_object()) throw InputError(where + ": expected an object");
  const std::string given = json_text(frame, "file_path", where);
  const fs::path path = path_inside(folder, given, where + ".file_path");
  view.image = find_image(path);
  if (view.image.empty()) throw InputError(path, "no such image, named by " + where);
  view.name = view.image.lexically_relative(folder).generic_string();
  view.mask = find_mask(folder, frame, view.image, where);
  read_intrinsics(frame, where, view);
  if (view.camera.fx == 0 && view.angle_x == 0) {
    throw InputError(where + ": no focal length; expected fl_x or camera_angle_x");
  }
  view.camera.camera_to_world = read_pose(frame, where);
  return view;
}

std::vector<RawView> read_frames(const fs::path& folder, const fs::path& file, const json& root) {
  const auto frames = root.is_object() ? root.find("frames") : root.end();
  if (!root.is_object() || frames == root.end() || !frames->is_array()) {
    throw InputError(file, "expected an object with an array 'frames'");
  }
  if (frames->empty()) throw InputError(file, "'frames' is empty; expected at least one view");
  RawView shared;
  shared.camera.cx = shared.camera.cy = std::numeric_limits<double>::quiet_NaN();
  read_intrinsics(root, file.string() + ": global", shared);
  std::vector<RawView> views;
  for (size_t i = 0; i < frames->size(); ++i) {
    const std::string where = file.string() + ": frames[" + std::to_string(i) + "]";
    views.push_back(read_frame(folder, (*frames)[i], shared, where));
  }
  return views;
}

/// Texts of an optional array of file names, normalised.
std::set<std::string> read_names(const json& root, const char* key, const fs::path& file) {
  std::set<std::string> names;
  const auto found = root.find(key);
  if (found == root.end()) return names;
  if (!found->is_array()) throw InputError(file, std::string(key) + ": expected an array");
  for (const json& name : *found) {
    if (!name.is_string()) throw InputError(file, std::string(key) + ": expected texts");
    names.insert(fs::path(name.get<std::string>()).lexically_normal().generic_string());
  }
  return names;
}

void add_file(RawCapture& capture, const fs::path& file) {
  capture.files.push_back(fs::absolute(file).lexically_normal().string());
}

}  // namespace

RawCapture read_nerf_synthetic(const fs::path& folder) {
  RawCapture capture;
  capture.format = "nerf-synthetic";
  const fs::path train = folder / "transforms_train.json";
  capture.train = read_frames(folder, train, read_json_file(train));
  add_file(capture, train);
  const fs::path test = folder / "transforms_test.json";
  if (fs::exists(test)) {
    capture.test = read_frames(folder, test, read_json_file(test));
    add_file(capture, test);
  }
  split_off_test(capture);
  return capture;
}

RawCapture read_nerfstudio(const fs::path& folder) {
  RawCapture capture;
  capture.format = "nerfstudio";
  const fs::path file = folder / "transforms.json";
  const json root = read_json_file(file);
  capture.train = read_frames(folder, file, root);
  add_file(capture, file);
  const std::set<std::string> test_names = read_names(root, "test_filenames", file);
  const auto is_test = [&](const RawView& view) { return test_names.contains(view.name); };
  std::copy_if(capture.train.begin(), capture.train.end(), std::back_inserter(capture.test),
               is_test);
  std::erase_if(capture.train, is_test);
  split_off_test(capture);
  return capture;
}

}  // namespace tt3d
