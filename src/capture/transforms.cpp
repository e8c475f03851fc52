#include <cmath>
#include <limits>
#include <set>

#include "camera.h"
#include "raw_view.h"
#include "split.h"
#include "tt3d/json.h"
#include "tt3d/linear.h"
#include "tt3d/scene.h"

// transforms.json and similar files. NeRF-synthetic (Mildenhall et al. 2020) has one horizontal
// field of view for all frames and one file per split. nerfstudio and instant-ngp have intrinsics
// in pixels, for all frames or per frame, with lens distortion.

namespace tt3d::capture {
namespace fs = std::filesystem;

namespace {

/// Throws InputError for lens models other than a pinhole with k1 k2 p1 p2.
void check_lens(const JsonValue& object) {
  static const std::set<std::string> known = {"",       "PINHOLE",       "SIMPLE_PINHOLE",
                                              "OPENCV", "SIMPLE_RADIAL", "RADIAL"};
  const auto model = object.get<std::string>("camera_model", "");
  const bool marked = object.raw().value("is_fisheye", nlohmann::json()) == nlohmann::json(true);
  if (!known.contains(model) || marked) {
    throw InputError(object.where() + ".camera_model: '" + (marked ? "is_fisheye" : model) +
                     "' is not supported; undistort the images to PINHOLE first, for example "
                     "with colmap image_undistorter");
  }
  for (const char* key : {"k3", "k4", "k5", "k6"}) {
    if (object.get(key, 0.0) != 0) {
      object.at(key).fail("only k1, k2, p1 and p2 are supported; undistort the images first");
    }
  }
}

int image_side(const JsonValue& object, const char* key, int fallback) {
  const double value = object.get(key, static_cast<double>(fallback));
  if (value < 0 || value > 1e6 || value != std::floor(value)) {
    object.at(key).fail("expected an integer number of pixels");
  }
  return static_cast<int>(value);
}

/// Overrides the shared intrinsics in `view` with those in `object`.
void read_intrinsics(const JsonValue& object, RawView& view) {
  check_lens(object);
  scene::Camera& camera = view.camera;
  camera.width = image_side(object, "w", camera.width);
  camera.height = image_side(object, "h", camera.height);
  view.angle_x = object.get("camera_angle_x", view.angle_x);
  view.angle_y = object.get("camera_angle_y", view.angle_y);
  const bool own_focal_length = object.raw().contains("fl_x");
  camera.fx = object.get("fl_x", camera.fx);
  camera.fy = object.get("fl_y", own_focal_length ? camera.fx : camera.fy);
  camera.cx = object.get("cx", camera.cx);
  camera.cy = object.get("cy", camera.cy);
  view.distortion.k1 = object.get("k1", view.distortion.k1);
  view.distortion.k2 = object.get("k2", view.distortion.k2);
  view.distortion.p1 = object.get("p1", view.distortion.p1);
  view.distortion.p2 = object.get("p2", view.distortion.p2);
}

scene::linear::Mat4 read_pose(const JsonValue& frame) {
  const std::string key = frame.where() + ".transform_matrix";
  const auto wrong = [&] { return InputError(key + ": expected 4 rows of 4 numbers"); };
  if (!frame.has("transform_matrix") || !frame.at("transform_matrix").raw().is_array()) {
    throw wrong();
  }
  const JsonValue rows = frame.at("transform_matrix");
  if (rows.size() < 3 || rows.size() > 4) throw wrong();
  scene::linear::Mat4 pose{};
  pose[15] = 1;
  for (size_t r = 0; r < rows.size(); ++r) {
    const JsonValue row = rows.at(r);
    if (!row.raw().is_array() || row.size() != 4) throw wrong();
    for (size_t c = 0; c < 4; ++c) pose[4 * r + c] = row.at(c).as<double>();
  }
  check_pose(pose, key);
  return pose;
}

/// The file that `mask_path` names; empty if the frame has none.
fs::path named_mask(const fs::path& folder, const JsonValue& frame) {
  const auto given = frame.get<std::string>("mask_path", "");
  if (given.empty()) return {};
  const fs::path path = path_inside(folder, given, frame.where() + ".mask_path");
  fs::path mask = find_picture(path);
  if (mask.empty()) throw InputError(path, "no such mask, named by " + frame.where());
  return mask;
}

RawView read_frame(const fs::path& folder, const JsonValue& frame, RawView view) {
  view.where = frame.where();
  const auto given = frame.get<std::string>("file_path", "");
  const fs::path path = path_inside(folder, given, view.where + ".file_path");
  view.image = find_picture(path);
  if (view.image.empty()) throw InputError(path, "no such image, named by " + view.where);
  view.name = view.image.lexically_relative(folder).generic_string();
  view.mask = named_mask(folder, frame);
  read_intrinsics(frame, view);
  if (view.camera.fx == 0 && view.angle_x == 0) {
    frame.fail("no focal length; expected fl_x or camera_angle_x");
  }
  view.camera.camera_to_world = read_pose(frame);
  return view;
}

std::vector<RawView> read_frames(const fs::path& folder, const JsonValue& root) {
  if (!root.raw().is_object() || !root.has("frames") || !root.at("frames").raw().is_array()) {
    root.fail("expected an object with an array 'frames'");
  }
  const JsonValue frames = root.at("frames");
  if (frames.size() == 0) root.fail("'frames' is empty; expected at least one view");
  RawView shared;
  shared.camera.cx = shared.camera.cy = std::numeric_limits<double>::quiet_NaN();
  read_intrinsics(root, shared);
  std::vector<RawView> views;
  for (size_t i = 0; i < frames.size(); ++i) {
    views.push_back(read_frame(folder, frames.at(i), shared));
  }
  return views;
}

std::vector<RawView> read_frames(const fs::path& folder, const fs::path& file) {
  const nlohmann::json document = read_json(file);
  return read_frames(folder, JsonValue(document, file));
}

/// The lists in transforms.json that split its frames.
SplitLists read_lists(const JsonValue& root) {
  const auto list = [&](const char* key) { return root.get<std::vector<std::string>>(key, {}); };
  return {list("train_filenames"), list("val_filenames"), list("test_filenames")};
}

/// The file of another split: transforms_train.json to transforms_test.json.
fs::path sibling(const fs::path& train, const std::string& split) {
  constexpr std::string_view kEnd = "train.json";
  const std::string name = train.filename().string();
  if (!name.ends_with(kEnd)) return {};
  return train.parent_path() / (name.substr(0, name.size() - kEnd.size()) + split + ".json");
}

}  // namespace

RawCapture read_nerf_synthetic(const CaptureSource& source) {
  RawCapture capture;
  capture.train = read_frames(source.folder, source.cameras);
  capture.files.push_back(absolute_name(source.cameras));
  drop_repeats(capture.train, capture.notes);
  for (const char* split : {"test", "val"}) {
    const fs::path file = sibling(source.cameras, split);
    if (file.empty() || !fs::exists(file)) continue;
    capture.test = read_frames(source.folder, file);
    capture.files.push_back(absolute_name(file));
    drop_repeats(capture.test, capture.notes);
    break;
  }
  return capture;
}

RawCapture read_nerfstudio(const CaptureSource& source) {
  RawCapture capture;
  const nlohmann::json document = read_json(source.cameras);
  const JsonValue root(document, source.cameras);
  capture.train = read_frames(source.folder, root);
  capture.files.push_back(absolute_name(source.cameras));
  drop_repeats(capture.train, capture.notes);
  split_by_lists(capture, read_lists(root), source.cameras);
  return capture;
}

}  // namespace tt3d::capture
