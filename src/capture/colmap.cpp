#include "colmap.h"

#include <algorithm>
#include <iterator>

#include "camera.h"
#include "split.h"
#include "tt3d/linear.h"

namespace tt3d::capture {
namespace fs = std::filesystem;
using namespace scene::linear;

namespace {

constexpr ColmapLens kLenses[] = {{"SIMPLE_PINHOLE", 3},
                                  {"PINHOLE", 4},
                                  {"SIMPLE_RADIAL", 4},
                                  {"RADIAL", 5},
                                  {"OPENCV", 8},
                                  {"OPENCV_FISHEYE", 8},
                                  {"FULL_OPENCV", 12},
                                  {"FOV", 5},
                                  {"SIMPLE_RADIAL_FISHEYE", 4},
                                  {"RADIAL_FISHEYE", 5},
                                  {"THIN_PRISM_FISHEYE", 12}};

[[noreturn]] void throw_lens_error(const ColmapCamera& camera, const std::string& where) {
  throw InputError(where + ": lens model " + kLenses[camera.model].name +
                   " is not supported; run colmap image_undistorter and use its output");
}

/// Intrinsics and distortion of the lens models that reduce to k1 k2 p1 p2.
void set_lens(const ColmapCamera& camera, const std::string& where, RawView& view) {
  const std::string lens = kLenses[camera.model].name;
  const std::vector<double>& p = camera.parameters;
  const bool single = lens == "SIMPLE_PINHOLE" || lens == "SIMPLE_RADIAL" || lens == "RADIAL";
  const bool brown = lens == "OPENCV" || lens == "FULL_OPENCV";
  if (!single && !brown && lens != "PINHOLE") throw_lens_error(camera, where);
  const size_t centre = single ? 1 : 2;
  view.camera.fx = p[0];
  view.camera.fy = p[centre - 1];
  view.camera.cx = p[centre];
  view.camera.cy = p[centre + 1];
  if (lens == "SIMPLE_RADIAL") view.distortion = {p[3], 0, 0, 0};
  if (lens == "RADIAL") view.distortion = {p[3], p[4], 0, 0};
  if (brown) view.distortion = {p[4], p[5], p[6], p[7]};
  const bool higher = std::any_of(p.begin() + std::min<std::ptrdiff_t>(8, std::ssize(p)), p.end(),
                                  [](double k) { return k != 0; });
  if (lens == "FULL_OPENCV" && higher) throw_lens_error(camera, where);
  for (const double value : p) {
    if (!std::isfinite(value)) throw InputError(where + ": its camera's parameters are not finite");
  }
}

/// Camera to world in OpenGL axes from COLMAP's world to camera (x right, y down, z forward).
Mat4 opengl_pose(const ColmapImage& image) {
  const auto& [w, x, y, z] = image.rotation;
  const double norm = std::sqrt(w * w + x * x + y * y + z * z);
  if (!std::isfinite(norm) || std::abs(norm - 1) > 1e-2) {
    throw InputError(image.where + ": the rotation is not a unit quaternion");
  }
  const double a = w / norm, b = x / norm, c = y / norm, d = z / norm;
  // Rows of the rotation are the camera's axes in the world.
  const Vec3 right = {1 - 2 * (c * c + d * d), 2 * (b * c - a * d), 2 * (b * d + a * c)};
  const Vec3 down = {2 * (b * c + a * d), 1 - 2 * (b * b + d * d), 2 * (c * d - a * b)};
  const Vec3 forward = {2 * (b * d - a * c), 2 * (c * d + a * b), 1 - 2 * (b * b + c * c)};
  const Vec3& t = image.translation;
  const Vec3 position = -1.0 * (t[0] * right + t[1] * down + t[2] * forward);
  return frame(right, -1.0 * down, -1.0 * forward, position);
}

/// A picture of a COLMAP model: in `images`, else relative to the capture's folder.
fs::path find_image(const fs::path& folder, const ColmapImage& image) {
  const fs::path path = path_inside(folder / "images", image.name, image.where);
  fs::path found = find_picture(path);
  if (found.empty()) found = find_picture(path_inside(folder, image.name, image.where));
  if (found.empty()) throw InputError(path, "no such image, named by " + image.where);
  return found;
}

RawView make_view(const fs::path& folder, const ColmapModel& model, const ColmapImage& image) {
  RawView view;
  view.where = image.where;
  view.image = find_image(folder, image);
  view.name = view.image.lexically_relative(folder).generic_string();
  const auto camera = model.cameras.find(image.camera);
  if (camera == model.cameras.end()) {
    throw InputError(image.where + ": camera " + std::to_string(image.camera) + " is not defined");
  }
  const ColmapCamera& lens = camera->second;
  if (lens.width <= 0 || lens.height <= 0 || std::max(lens.width, lens.height) > 1000000) {
    throw InputError(image.where + ": its camera's image size is out of range");
  }
  view.camera.width = static_cast<int>(lens.width);
  view.camera.height = static_cast<int>(lens.height);
  set_lens(lens, image.where, view);
  view.camera.camera_to_world = opengl_pose(image);
  check_pose(view.camera.camera_to_world, image.where);
  return view;
}

/// True if the model is from 'tt3d photos', which turns it and says so in the first line.
bool says_upright(const fs::path& model) {
  const fs::path file = model / "images.txt";
  std::error_code error;
  return fs::exists(file, error) && read_file(file).starts_with("# tt3d: the world is upright");
}

}  // namespace

const ColmapLens* colmap_lens(int model) {
  return model >= 0 && model < std::ssize(kLenses) ? &kLenses[model] : nullptr;
}

int colmap_lens_number(const std::string& name) {
  const auto* found = std::find_if(std::begin(kLenses), std::end(kLenses),
                                   [&](const ColmapLens& lens) { return name == lens.name; });
  return found == std::end(kLenses) ? -1 : static_cast<int>(found - std::begin(kLenses));
}

RawCapture read_colmap(const CaptureSource& source) {
  ColmapModel model = read_colmap_model(source.cameras);
  if (model.images.empty()) {
    throw InputError(model.files.back(),
                     "contains no images; expected at least one registered view");
  }
  std::sort(model.images.begin(), model.images.end(),
            [](const ColmapImage& a, const ColmapImage& b) { return a.name < b.name; });
  RawCapture capture;
  for (const ColmapImage& image : model.images) {
    capture.train.push_back(make_view(source.folder, model, image));
  }
  capture.notes = std::move(model.notes);
  drop_repeats(capture.train, capture.notes);
  capture.points = std::move(model.points);
  capture.upright = says_upright(source.cameras);
  for (const fs::path& file : model.files) capture.files.push_back(absolute_name(file));
  return capture;
}

}  // namespace tt3d::capture
