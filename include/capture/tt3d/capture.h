#pragma once

#include <ATen/core/Tensor.h>

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "tt3d/core.h"
#include "tt3d/keys.h"
#include "tt3d/scene.h"

/// Photographs with cameras, and readers of their file formats.
namespace tt3d::capture {

/// File format of a capture's cameras.
enum class CaptureFormat { kAuto, kNerfSynthetic, kNerfstudio, kColmap };
[[nodiscard]] constexpr std::array<std::string_view, 4> enum_names(CaptureFormat) {
  return {"auto", "nerf-synthetic", "nerfstudio", "colmap"};
}

/// The direction in the world of the cameras that becomes +Z.
enum class UpDirection { kAuto, kX, kY, kZ, kMinusX, kMinusY, kMinusZ };
[[nodiscard]] constexpr std::array<std::string_view, 7> enum_names(UpDirection) {
  return {"auto", "x", "y", "z", "-x", "-y", "-z"};
}

/// One photograph and its camera (in the normalised frame).
struct View {
  std::string name;  ///< path of the image relative to the capture, for messages
  scene::Camera camera;
  at::Tensor rgba;  ///< [H,W,4] uint8, sRGB, straight alpha (mask), undistorted
};

/// All photographs of one object.
struct Capture {
  std::vector<View> train;
  /// Held out: the format's test views, else its validation views, else every 8th view.
  std::vector<View> test;
  bool has_masks = false;              ///< true if alpha separates object and background
  scene::Normalization normalization;  ///< from the world to the normalised frame of the cameras
  double object_radius = 1;  ///< bound on the object's distance from the origin, normalised
  CaptureFormat format = CaptureFormat::kAuto;  ///< the detected format
  bool has_gains = false;                       ///< true if gains.json evened the exposure
  std::vector<std::string> files;  ///< cameras, pictures and masks that were read, absolute; a run
                                   ///< records their hashes
};

struct CaptureOptions {
  std::filesystem::path path;
  CaptureFormat format = CaptureFormat::kAuto;
  UpDirection up = UpDirection::kAuto;
  int max_size = 400;
  int max_train_views = 0;
  int max_test_views = 0;

  void keys(KeyList& key) {
    key("path", path, "folder of the photographs and their cameras, or a camera file");
    key("format", format, "file format of the cameras");
    key("up", up,
        "up direction in the world of the cameras' file; auto: +Z, and for a COLMAP model, whose "
        "world has no meaning, the up direction of the cameras");
    key("max_size", max_size, {0, 16384}, "pixels",
        "photographs are reduced to this longer side by area averaging; 0 keeps them");
    key("max_train_views", max_train_views, {0, 1e6}, "",
        "evenly spaced subset of the training views; 0 takes all");
    key("max_test_views", max_test_views, {0, 1e6}, "",
        "evenly spaced subset of the test views; 0 takes all");
  }
};

/// Reads a capture. Notes to `progress` what it merges or leaves out. Throws InputError with file
/// and problem: missing, empty or corrupt images; sizes that differ from the camera file; NaN,
/// singular or mirrored matrices; no frames; paths outside the folder of the capture; masks or
/// splits that contradict each other; an object that no camera sees. Throws ResourceError if the
/// photographs need more memory than is free.
[[nodiscard]] Capture load_capture(const CaptureOptions& options, Progress& progress);

/// The view frame of a capture, in normalised coordinates: centre at the origin, median camera
/// distance and median vertical field of view. Throws InputError if the capture has no training
/// views.
[[nodiscard]] scene::ViewFrame capture_view_frame(const Capture& capture);

// ---- Judgement ----------------------------------------------------------------------------

/// What is measured of one photograph.
struct ViewQuality {
  std::string name;
  /// Overlap (intersection over union) of its mask with the hull that most masks agree on.
  double hull_overlap = 0;
  double mask_share = 0;  ///< fraction of the picture that is object
  double sharpness = 0;   ///< 0 (blurred) to 1, of the object
  double brightness = 0;  ///< mean level of the object, 0 to 1
  double azimuth_deg = 0, elevation_deg = 0;
  std::string problem;  ///< what is wrong with its mask, for the user; empty: nothing
};

/// What is measured of a capture.
struct CaptureQuality {
  std::vector<ViewQuality> views;  ///< training views, then test views
  double hull_overlap = 0;         ///< median of the views
  double coverage = 0;  ///< fraction of the directions above the horizon (up to 75 degrees) with
                        ///< a camera within 25 degrees
  double largest_gap_deg = 0;              ///< largest step in azimuth between neighbouring cameras
  double lowest_deg = 0, highest_deg = 0;  ///< elevations of the cameras
  double sharpness = 0;                    ///< median of the views
  double exposure_spread = 0;       ///< standard deviation of log2 of the object's brightness
  std::vector<std::string> advice;  ///< what to do better, a line each
};

/// Measures a capture with masks. Without masks only sharpness and coverage are measured.
[[nodiscard]] CaptureQuality assess_capture(const Capture& capture, Progress& progress);

/// Renders a camera's view: [H,W,4] premultiplied.
using ViewRenderer = std::function<at::Tensor(const scene::Camera&)>;
/// Mean PSNR between renderings and photographs, in dB, each composited over white, as in NeRF
/// papers. 0 without views.
[[nodiscard]] double mean_psnr(const std::vector<View>& views, const ViewRenderer& render,
                               Progress& progress);

}  // namespace tt3d::capture
