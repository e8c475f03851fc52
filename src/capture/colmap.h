#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "raw_view.h"
#include "tt3d/linear.h"

/// The parts of a COLMAP sparse model that a capture needs, independent of the encoding
/// (https://colmap.github.io/format.html).
namespace tt3d::capture {

struct ColmapCamera {
  int model = 0;  ///< COLMAP's model number, see colmap_lens
  int64_t width = 0, height = 0;
  std::vector<double> parameters;
};

struct ColmapImage {
  std::array<double, 4> rotation{};   ///< world to camera, quaternion w x y z
  scene::linear::Vec3 translation{};  ///< world to camera
  int64_t camera = 0;
  std::string name;   ///< relative to the images folder
  std::string where;  ///< file and record, for error messages
};

struct ColmapModel {
  std::map<int64_t, ColmapCamera> cameras;
  std::vector<ColmapImage> images;
  std::vector<scene::linear::Vec3> points;
  std::vector<std::string> notes;            ///< what the user should know, a line each
  std::vector<std::filesystem::path> files;  ///< read: of the cameras, then of the images
};

/// A lens model: its name in text files and its number of parameters.
struct ColmapLens {
  const char* name;
  size_t parameters;
};

/// Lens model by COLMAP's number; nullptr if there is none.
[[nodiscard]] const ColmapLens* colmap_lens(int model);
/// Number of the model of that name, or -1.
[[nodiscard]] int colmap_lens_number(const std::string& name);

[[nodiscard]] ColmapModel read_colmap_binary(const std::filesystem::path& folder);
[[nodiscard]] ColmapModel read_colmap_text(const std::filesystem::path& folder);
/// Reads a model in either encoding. Throws InputError if the folder holds both and they differ.
[[nodiscard]] ColmapModel read_colmap_model(const std::filesystem::path& folder);

}  // namespace tt3d::capture
