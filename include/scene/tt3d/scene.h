#pragma once

#include <ATen/core/Tensor.h>

#include <array>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "tt3d/core.h"
#include "tt3d/enums.h"

/// Cameras, projection, the normalised frame, random views and backgrounds. Frames: world
/// right-handed, +Z up; cameras as in OpenGL (x right, y up, looking along -z); pinhole in pixels,
/// pixel centres at .5.
namespace tt3d::scene {

// ---- Cameras and projection ---------------------------------------------------------------

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

/// World-to-clip matrices of cameras, [N,4,4] float32. The depth range fits a ball of radius
/// `extent` around the origin.
[[nodiscard]] at::Tensor clip_matrices(const std::vector<Camera>& cameras, double extent = 2);
/// Transforms vertices [V,3] by matrices [N,4,4] of the same dtype to clip coordinates [N,V,4].
/// Differentiable with respect to the vertices.
[[nodiscard]] at::Tensor to_clip(const at::Tensor& vertices, const at::Tensor& matrices);

/// The rectangle of pixels around the object in a view.
struct PixelBox {
  int64_t left = 0, top = 0, right = 0, bottom = 0;  ///< right and bottom are exclusive
};
/// The rectangle around the projections of all vertices [V,3], clipped to the picture, at least 11
/// pixels a side (the window of SSIM). It is the whole picture if a vertex is behind the camera.
[[nodiscard]] PixelBox object_box(const Camera& camera, const at::Tensor& vertices);

// ---- Views --------------------------------------------------------------------------------

/// A sampled view: the camera and its parameters.
struct SampledView {
  Camera camera;
  double azimuth_deg = 0;
  double elevation_deg = 0;
  double distance = 0;  ///< from the look-at point, world units
  double roll_deg = 0;
};

/// The frame that scales a view distribution: centre and size of the object, typical camera
/// distance and field of view.
struct ViewFrame {
  std::array<double, 3> centre{0, 0, 0};
  double radius = 1;                  ///< radius of the object's bounding sphere
  double distance = 4;                ///< median camera distance of the capture
  double fov_y_deg = 40;              ///< vertical field of view
  std::array<double, 3> up{0, 0, 1};  ///< unit vector that the views take as up
};

/// Distributions of random views.
enum class ViewDistribution {
  kRing,    ///< azimuth U(0,360), elevation 15
  kDome,    ///< azimuth U(0,360), elevation U(-20,75), distance U(0.95,1.25) times that of the
            ///< frame, roll U(-10,10), look-at point jittered by 5 % of the radius
  kSphere,  ///< uniform over all directions
  kPaper,   ///< three rotations U(-60,120), as in the official code
};
[[nodiscard]] constexpr std::array<std::string_view, 4> enum_names(ViewDistribution) {
  return {"ring", "dome", "sphere", "paper"};
}

/// `count` views of `size` x `size` pixels: view i depends on (distribution, seed, first + i)
/// alone, so the same call gives the same cameras on any machine.
[[nodiscard]] std::vector<SampledView> sample_views(ViewDistribution distribution, uint64_t seed,
                                                    int64_t first, int64_t count, int size,
                                                    const ViewFrame& frame);

/// The view of `size` x `size` pixels from an azimuth and elevation in degrees, at the distance of
/// the frame from its centre.
[[nodiscard]] SampledView orbit_view(const ViewFrame& frame, double azimuth_deg,
                                     double elevation_deg, int size);

/// The cameras of views, in their order.
[[nodiscard]] std::vector<Camera> cameras_of(const std::vector<SampledView>& views);

// ---- The normalised frame -----------------------------------------------------------------

/// Similarity that turns the world upright and scales the object into [-1,1]^3:
/// inside = scale * R (world - centre), where R is the smallest rotation that turns `up` to +Z.
struct Normalization {
  double scale = 1;
  std::array<double, 3> centre{0, 0, 0};
  std::array<double, 3> up{0, 0, 1};  ///< unit vector, in the world

  /// Transforms points [V,3] from the world to the normalised frame, and back. Computes in float64,
  /// returns float32.
  [[nodiscard]] at::Tensor to_inside(const at::Tensor& points) const;
  [[nodiscard]] at::Tensor to_world(const at::Tensor& points) const;
  /// Transforms a camera or a view frame from the normalised frame to the world.
  [[nodiscard]] Camera to_world(Camera camera) const;
  [[nodiscard]] ViewFrame to_world(ViewFrame frame) const;
  /// Transforms a camera from the world to the normalised frame.
  [[nodiscard]] Camera to_inside(Camera camera) const;
};

/// The placement of an object: its normalised frame, and its view frame in normalised coordinates.
struct Placement {
  Normalization normalization;
  ViewFrame frame;
};

// ---- Backgrounds --------------------------------------------------------------------------

/// Backgrounds of rendered objects: white, one colour, or random photographs.
class Backgrounds {
 public:
  /// "white", "#rrggbb", or a folder of PNG or JPEG files. Throws InputError for anything else.
  explicit Backgrounds(const std::string& text);
  /// A background [H,W,3] float32 sRGB in [0,1]. A photograph fills the frame, cropped around its
  /// centre. It is decoded once and kept while all decoded photographs stay below 256 MiB. Throws
  /// InputError for a photograph that cannot be read. Call from one thread at a time.
  [[nodiscard]] at::Tensor draw(int64_t height, int64_t width, Random& random) const;

 private:
  [[nodiscard]] at::Tensor photograph(size_t index) const;

  at::Tensor color_;
  std::vector<std::filesystem::path> photographs_;
  mutable std::vector<at::Tensor> decoded_;  ///< [H,W,3] uint8; undefined: not read yet
  mutable int64_t decoded_bytes_ = 0;
};

}  // namespace tt3d::scene
