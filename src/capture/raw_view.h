#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "tt3d/capture.h"
#include "tt3d/linear.h"
#include "tt3d/scene.h"

/// The result of the format readers for load_capture: cameras and file names, no pixels yet.
namespace tt3d::capture {

/// Radial and tangential lens distortion (Brown; OpenCV's k1, k2, p1, p2).
struct Distortion {
  double k1 = 0, k2 = 0, p1 = 0, p2 = 0;
  [[nodiscard]] bool none() const { return k1 == 0 && k2 == 0 && p1 == 0 && p2 == 0; }
};

/// One frame of a camera file, in the world of that file.
struct RawView {
  std::string name;   ///< image path relative to the capture
  std::string where;  ///< file and key, for error messages
  std::filesystem::path image;
  std::filesystem::path mask;  ///< empty: alpha of the image, if any
  scene::Camera camera;        ///< if the file omits them: width, height, fx are 0; cx, cy NaN
  double angle_x = 0;          ///< horizontal field of view in radians, if fx is 0
  double angle_y = 0;          ///< vertical, 0 if the pixels are square
  Distortion distortion;
};

struct RawCapture {
  std::vector<RawView> train;
  std::vector<RawView> test;
  bool upright = false;                     ///< a COLMAP model that says that its world has +Z up
  std::vector<scene::linear::Vec3> points;  ///< sparse points of the scene, if the format has them
  std::vector<std::string> files;           ///< camera files read, absolute
  std::vector<std::string> notes;           ///< what the user should know, a line each
};

/// The cameras of a capture: what CaptureOptions.path stands for.
struct CaptureSource {
  CaptureFormat format = CaptureFormat::kAuto;
  std::filesystem::path folder;   ///< paths of pictures are relative to this
  std::filesystem::path cameras;  ///< a JSON file, or the folder of a COLMAP model
  std::vector<std::string> notes;
};

/// Finds the cameras in a folder, or by the name of one of their files. Throws InputError if there
/// are none.
[[nodiscard]] CaptureSource find_source(const CaptureOptions& options);

/// A file of NeRF-synthetic for training (transforms_train.json), and its sibling for tests:
/// transforms_test.json, else transforms_val.json.
[[nodiscard]] RawCapture read_nerf_synthetic(const CaptureSource& source);
/// transforms.json, with train_filenames, val_filenames and test_filenames if present.
[[nodiscard]] RawCapture read_nerfstudio(const CaptureSource& source);
/// A COLMAP sparse model; images in `folder`/images, or relative to `folder`.
[[nodiscard]] RawCapture read_colmap(const CaptureSource& source);

/// True if the folder holds a COLMAP model, binary or text.
[[nodiscard]] bool is_colmap_model(const std::filesystem::path& folder);
/// The COLMAP model of a capture: the one with the most pictures among sparse, colmap/sparse, the
/// folders in them, and the folder itself. Empty if there is none. If there are several, a line in
/// `notes` says which is read.
[[nodiscard]] std::filesystem::path find_colmap_model(const std::filesystem::path& folder,
                                                      std::vector<std::string>& notes);

/// `path` for a message or a record of the run: absolute.
[[nodiscard]] std::string absolute_name(const std::filesystem::path& path);

/// `path` with '/' between names and without the extension of its last name.
[[nodiscard]] std::string without_extension(std::filesystem::path path);

/// `relative` (from a camera file) inside `folder`, with '/' or '\' between names; throws
/// InputError if it is empty or leads out of the folder.
[[nodiscard]] std::filesystem::path path_inside(const std::filesystem::path& folder,
                                                const std::string& relative,
                                                const std::string& where);

/// The picture at `path`, or, if there is none, at `path` with an extension added, or with a name
/// that differs in upper and lower case only. Empty if there is no such file.
[[nodiscard]] std::filesystem::path find_picture(const std::filesystem::path& path);

}  // namespace tt3d::capture
