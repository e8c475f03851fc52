#pragma once

#include <ATen/core/Tensor.h>

#include <array>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "tt3d/core.h"

/// Photographs with cameras, the file formats they come in, and the random views that attack and
/// evaluation draw. Frames: world right-handed, +Z up; cameras OpenGL (x right, y up, looking
/// down -z); pinhole in pixels, pixel centres at .5.
namespace tt3d {

// ---- Images -------------------------------------------------------------------------------

/// Reads a PNG or JPEG (by content, not by name; 8 or 16 bit, grey, palette, RGB, with or without
/// alpha; EXIF ignored). Returns [H,W,4] uint8, sRGB, straight alpha, row 0 at the top; alpha is
/// 255 where the file has none. Throws InputError (missing, empty, truncated, corrupt, too large).
[[nodiscard]] at::Tensor read_image(const std::filesystem::path& path);

/// True if the image file has an alpha channel or transparency.
[[nodiscard]] bool image_has_alpha(const std::filesystem::path& path);

/// Encodes [H,W,C] uint8 with C = 1, 3 or 4 as PNG; returns the file's bytes.
[[nodiscard]] std::string encode_png(const at::Tensor& image);
/// Encodes [H,W,3] uint8 as JPEG of the given quality (1..100); returns the file's bytes.
[[nodiscard]] std::string encode_jpeg(const at::Tensor& image, int quality = 90);
/// Decodes PNG or JPEG bytes as read_image does; `name` is used in errors.
[[nodiscard]] at::Tensor decode_image(std::string_view bytes, const std::filesystem::path& name);

/// float [H,W,C] in [0,1] (clamped) to uint8, rounding to nearest.
[[nodiscard]] at::Tensor to_uint8(const at::Tensor& image);

// ---- Cameras ------------------------------------------------------------------------------

/// A pinhole camera.
struct Camera {
  /// Row-major 4x4, camera to world, rigid.
  std::array<double, 16> camera_to_world{};
  double fx = 0, fy = 0, cx = 0, cy = 0;  ///< pixels
  int width = 0, height = 0;              ///< pixels
  [[nodiscard]] std::array<double, 3> position() const {
    return {camera_to_world[3], camera_to_world[7], camera_to_world[11]};
  }
};

/// World-to-clip matrix, row-major 4x4, OpenGL clip space (x right, y up, z in [-w, w]) for the
/// near and far distances. Pixel (column c, row r) of the image, centre (c+.5, r+.5), has
/// x/w = 2 (c+.5)/width - 1 and y/w = 1 - 2 (r+.5)/height: row 0 is at the top.
[[nodiscard]] std::array<double, 16> world_to_clip(const Camera& camera, double near_distance,
                                                   double far_distance);

/// Similarity that scales the object into [-1,1]^3: inside = scale * (world - centre).
struct Normalization {
  double scale = 1;
  std::array<double, 3> centre{0, 0, 0};
};

// ---- Captures -----------------------------------------------------------------------------

/// One photograph and its camera (in the normalised frame).
struct View {
  std::string name;  ///< path of the image relative to the capture, for messages
  Camera camera;
  at::Tensor rgba;  ///< [H,W,4] uint8, sRGB, straight alpha (mask), undistorted
};

/// All photographs of one object.
struct Capture {
  std::vector<View> train;
  std::vector<View> test;          ///< held out; from the format's test split, else every 8th view
  bool has_masks = false;          ///< alpha tells object from background
  Normalization normalization;     ///< world to the normalised frame of the cameras
  double object_radius = 1;        ///< bound on the object's distance from the origin, normalised
  std::string format;              ///< "nerf-synthetic", "nerfstudio" or "colmap"
  std::vector<std::string> files;  ///< camera files that were read, absolute, for the run's hash
};

struct CaptureOptions {
  std::filesystem::path path;
  std::string format = "auto";  ///< auto, nerf-synthetic, nerfstudio, colmap
  int max_size =
      0;  ///< images are area-averaged so that the longer side is at most this; 0: as they are
  int max_train_views = 0;  ///< evenly spaced subset; 0: all
  int max_test_views = 0;   ///< evenly spaced subset; 0: all
};

/// Reads a capture. Throws InputError naming file and problem: missing, empty, corrupt images;
/// sizes that disagree with the camera file; NaN, singular or mirrored matrices; no frames; paths
/// that leave the capture's folder; an object that no camera sees.
[[nodiscard]] Capture load_capture(const CaptureOptions& options, Progress& progress);

// ---- Random views -------------------------------------------------------------------------

/// A sampled view: the camera and the parameters it came from.
struct SampledView {
  Camera camera;
  double azimuth_deg = 0;
  double elevation_deg = 0;
  double distance = 0;  ///< from the look-at point, world units
  double roll_deg = 0;
};

/// What a view distribution is scaled by: the object's centre and typical camera distance.
struct ViewFrame {
  std::array<double, 3> centre{0, 0, 0};
  double radius = 1;      ///< radius of the object's bounding sphere
  double distance = 4;    ///< median camera distance of the capture
  double fov_y_deg = 40;  ///< vertical field of view
};

/// The frame of a capture's views in its normalised frame: centre at the origin, median camera
/// distance and median vertical field of view. Throws InputError if it has no training views.
[[nodiscard]] ViewFrame capture_view_frame(const Capture& capture);

/// Names of the view distributions (design, section 9): ring, dome, sphere, paper.
[[nodiscard]] const std::vector<std::string>& view_distribution_names();

/// `count` views of `size` x `size` pixels: view i depends on (name, seed, first + i) alone, so
/// the same call gives the same cameras on any machine. Throws InputError for an unknown name.
[[nodiscard]] std::vector<SampledView> sample_views(const std::string& distribution, uint64_t seed,
                                                    int64_t first, int64_t count, int size,
                                                    const ViewFrame& frame);

// ---- Backgrounds --------------------------------------------------------------------------

/// What stands behind a rendered object: white, one colour, or photographs drawn at random.
class Backgrounds {
 public:
  /// "white", "#rrggbb", or a folder of PNG or JPEG files. Throws InputError for anything else.
  explicit Backgrounds(const std::string& text);
  /// A background [H,W,3] float32 sRGB in [0,1]. A photograph covers the frame, cropped around its
  /// centre. Throws InputError for a photograph that cannot be read.
  [[nodiscard]] at::Tensor draw(int64_t height, int64_t width, Random& random) const;

 private:
  at::Tensor color_;
  std::vector<std::filesystem::path> photographs_;
};

}  // namespace tt3d
