#pragma once

#include <array>
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "tt3d/capture.h"

/// Captures with known content: coloured balls, drawn with the textbook pinhole formula. The code
/// that writes each format is independent of the readers.
namespace tt3d::testing {

using Vec3 = std::array<double, 3>;

/// A small ball of one colour; drawn as a disc.
struct Ball {
  Vec3 position;
  std::array<uint8_t, 3> colour;
};

/// A camera by its position and axes, and its lens.
struct FixtureCamera {
  Vec3 position, right, up, forward;
  int width = 120, height = 90;
  double fx = 150, fy = 150, cx = 60, cy = 45;
  std::array<double, 4> distortion{};  ///< k1 k2 p1 p2
};

/// The balls of the fixture: red, green and blue; no flip maps them onto themselves.
[[nodiscard]] const std::vector<Ball>& fixture_balls();
inline constexpr double kBallRadius = 0.16;

/// `count` cameras on a spiral around (1, -2, 3), the centre of the balls, looking at it.
[[nodiscard]] std::vector<FixtureCamera> fixture_cameras(int count);

/// Column and row (pixel centres at .5) of a point, with the lens distortion.
[[nodiscard]] std::array<double, 2> project(const FixtureCamera& camera, const Vec3& point);

/// [H,W,4] picture of the balls; the other pixels are transparent, with a misleading pink.
[[nodiscard]] at::Tensor draw(const FixtureCamera& camera);

/// Writers. Images go to images/ (train/ and test/ for NeRF-synthetic) as view_00.png, ...
void write_nerf_synthetic(const std::filesystem::path& folder,
                          const std::vector<FixtureCamera>& train,
                          const std::vector<FixtureCamera>& test);
void write_nerfstudio(const std::filesystem::path& folder,
                      const std::vector<FixtureCamera>& cameras);
void write_colmap_text(const std::filesystem::path& folder,
                       const std::vector<FixtureCamera>& cameras);
void write_colmap_binary(const std::filesystem::path& folder,
                         const std::vector<FixtureCamera>& cameras);

/// Edits a JSON file in place.
void edit_json(const std::filesystem::path& path, const std::function<void(nlohmann::json&)>& edit);

/// Loads with default options.
[[nodiscard]] capture::Capture load(const std::filesystem::path& folder,
                                    const std::string& format = "auto");

}  // namespace tt3d::testing
