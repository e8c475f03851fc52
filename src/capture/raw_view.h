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
  std::vector<scene::linear::Vec3> points;  ///< sparse points of the scene, if the format has them
  std::vector<std::string> files;           ///< camera files read, absolute
};

/// transforms_train.json and transforms_test.json (val is not used).
[[nodiscard]] RawCapture read_nerf_synthetic(const std::filesystem::path& folder);
/// transforms.json, with train_filenames and test_filenames if present.
[[nodiscard]] RawCapture read_nerfstudio(const std::filesystem::path& folder);
/// A COLMAP sparse model in `folder`/sparse/0, `folder`/sparse, `folder`/colmap/sparse/0 or
/// `folder`; images in `folder`/images.
[[nodiscard]] RawCapture read_colmap(const std::filesystem::path& folder);
/// The folder of the COLMAP model, or an empty path.
[[nodiscard]] std::filesystem::path find_colmap_model(const std::filesystem::path& folder);

/// Moves every 8th view to `test` if the format has no test split and there is more than one view.
void split_off_test(RawCapture& capture);

/// `relative` (from a camera file) inside `folder`; throws InputError if it is absolute, empty or
/// leads out of the folder.
[[nodiscard]] std::filesystem::path path_inside(const std::filesystem::path& folder,
                                                const std::string& relative,
                                                const std::string& where);

/// The first path that is a file, or an empty path.
[[nodiscard]] std::filesystem::path first_file(const std::vector<std::filesystem::path>& paths);

}  // namespace tt3d::capture
