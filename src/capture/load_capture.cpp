#include <ATen/ATen.h>

#include <atomic>
#include <exception>
#include <thread>

#include "camera.h"
#include "normalize.h"
#include "raw_view.h"
#include "resample.h"
#include "tt3d/image.h"
#include "tt3d/scene.h"

namespace tt3d::capture {
namespace fs = std::filesystem;

namespace {

/// Number of threads that decode views; each holds one full-size image.
constexpr int kLoaderThreads = 2;
constexpr int kTestEvery = 8;

CaptureFormat detect_format(const fs::path& folder) {
  if (fs::exists(folder / "transforms_train.json")) return CaptureFormat::kNerfSynthetic;
  if (fs::exists(folder / "transforms.json")) return CaptureFormat::kNerfstudio;
  if (!find_colmap_model(folder).empty()) return CaptureFormat::kColmap;
  throw InputError(folder,
                   "contains no capture; expected transforms_train.json (NeRF-synthetic), "
                   "transforms.json (nerfstudio) or a COLMAP model in sparse/0");
}

RawCapture read_cameras(const fs::path& folder, CaptureFormat format) {
  if (format == CaptureFormat::kNerfSynthetic) return read_nerf_synthetic(folder);
  if (format == CaptureFormat::kNerfstudio) return read_nerfstudio(folder);
  return read_colmap(folder);
}

void keep_evenly(std::vector<RawView>& views, int count) {
  const size_t keep = static_cast<size_t>(std::max(count, 0));
  if (keep == 0 || keep >= views.size()) return;
  std::vector<RawView> kept;
  for (size_t i = 0; i < keep; ++i) kept.push_back(std::move(views[i * views.size() / keep]));
  views = std::move(kept);
}

/// Fills in what the camera file omits, and checks the image size against the file.
void complete_camera(const RawView& raw, int width, int height, scene::Camera& camera) {
  const bool sized = camera.width > 0 || camera.height > 0;
  if (sized && (camera.width != width || camera.height != height)) {
    throw InputError(raw.image, "is " + std::to_string(width) + "x" + std::to_string(height) +
                                    " pixels, but " + raw.where + " says " +
                                    std::to_string(camera.width) + "x" +
                                    std::to_string(camera.height) +
                                    "; use the images the cameras were computed from");
  }
  camera.width = width;
  camera.height = height;
  if (camera.fx == 0) {
    camera.fx = 0.5 * width / std::tan(0.5 * raw.angle_x);
    camera.fy = raw.angle_y > 0 ? 0.5 * height / std::tan(0.5 * raw.angle_y) : camera.fx;
  }
  if (std::isnan(camera.cx)) camera.cx = 0.5 * width;
  if (std::isnan(camera.cy)) camera.cy = 0.5 * height;
  check_intrinsics(camera, raw.where);
}

/// Multiplies the alpha of an image by the grey value of its mask file.
void apply_mask(at::Tensor& rgba, const RawView& raw) {
  const at::Tensor mask = image::read_image(raw.mask);
  if (mask.size(0) != rgba.size(0) || mask.size(1) != rgba.size(1)) {
    throw InputError(raw.mask, "is " + std::to_string(mask.size(1)) + "x" +
                                   std::to_string(mask.size(0)) +
                                   " pixels, expected the size of its image " + raw.name);
  }
  const uint8_t* m = mask.data_ptr<uint8_t>();
  uint8_t* p = rgba.data_ptr<uint8_t>();
  for (int64_t i = 0; i < rgba.size(0) * rgba.size(1); ++i, p += 4, m += 4) {
    p[3] = static_cast<uint8_t>((p[3] * ((m[0] * m[3] + 127) / 255) + 127) / 255);
  }
}

/// Decodes one photograph; true if it has a mask (alpha channel or mask file).
bool load_view(const RawView& raw, int max_size, View& view) {
  view.name = raw.name;
  view.camera = raw.camera;
  view.rgba = image::read_image(raw.image);
  complete_camera(raw, static_cast<int>(view.rgba.size(1)), static_cast<int>(view.rgba.size(0)),
                  view.camera);
  if (!raw.mask.empty()) apply_mask(view.rgba, raw);
  const bool has_mask = !raw.mask.empty() || image::image_has_alpha(raw.image);
  if (!raw.distortion.none()) {
    view.rgba = undistort(view.rgba, view.camera, raw.distortion, has_mask);
  }
  limit_size(view, max_size);
  return has_mask;
}

/// Loads all views on a few threads, reports progress from the calling thread, and returns which
/// views have masks. If several views fail, it throws the error of the first one in order.
class Loader {
 public:
  Loader(const std::vector<RawView>& raw, int max_size, Progress& progress)
      : raw_(raw),
        max_size_(max_size),
        progress_(progress),
        views_(raw.size()),
        masks_(raw.size()),
        errors_(raw.size()) {}

  std::vector<View> run() {
    std::vector<std::jthread> helpers;
    for (int i = 1; i < kLoaderThreads; ++i) helpers.emplace_back([this] { work(false); });
    work(true);
    helpers.clear();
    progress_.check();
    for (const std::exception_ptr& error : errors_) {
      if (error) std::rethrow_exception(error);
    }
    return std::move(views_);
  }

  [[nodiscard]] const std::vector<char>& masks() const { return masks_; }

 private:
  void work(bool report) {
    for (size_t i = next_++; i < raw_.size() && !stop_; i = next_++) {
      try {
        masks_[i] = load_view(raw_[i], max_size_, views_[i]) ? 1 : 0;
      } catch (...) {
        errors_[i] = std::current_exception();
        stop_ = true;
      }
      ++done_;
      if (!report) continue;
      progress_.update(done_, {});
      if (progress_.cancelled()) stop_ = true;
    }
  }

  const std::vector<RawView>& raw_;
  int max_size_;
  Progress& progress_;
  std::vector<View> views_;
  std::vector<char> masks_;
  std::vector<std::exception_ptr> errors_;
  std::atomic<size_t> next_ = 0;
  std::atomic<int64_t> done_ = 0;
  std::atomic<bool> stop_ = false;
};

/// Either all views have a mask or none has: in a mixture, the training would treat backgrounds as
/// object.
bool agree_on_masks(const std::vector<RawView>& raw, const std::vector<View>& views,
                    const std::vector<char>& masks) {
  bool transparent = false;
  size_t without = raw.size();
  for (size_t i = 0; i < raw.size(); ++i) {
    if (masks[i] == 0) without = std::min(without, i);
    transparent = transparent || views[i].rgba.select(2, 3).min().item<uint8_t>() < 255;
  }
  if (!transparent) return false;
  if (without < raw.size()) {
    throw InputError(raw[without].image,
                     "has neither alpha nor a mask file, but other images of "
                     "the capture do; give every image a mask");
  }
  return true;
}

}  // namespace

fs::path first_file(const std::vector<fs::path>& paths) {
  for (const fs::path& path : paths) {
    std::error_code error;
    if (fs::is_regular_file(path, error)) return path;
  }
  return {};
}

fs::path path_inside(const fs::path& folder, const std::string& relative,
                     const std::string& where) {
  if (relative.empty()) throw InputError(where + ": expected the path of an image");
  const fs::path path = fs::path(relative).lexically_normal();
  if (path.is_absolute() || *path.begin() == "..") {
    throw InputError(where + ": '" + relative +
                     "' leads out of the capture's folder; expected "
                     "a path relative to and inside " +
                     folder.string());
  }
  return (folder / path).lexically_normal();
}

void split_off_test(RawCapture& capture) {
  if (!capture.test.empty() || capture.train.size() < 2) return;
  std::vector<RawView> train;
  for (size_t i = 0; i < capture.train.size(); ++i) {
    (i % kTestEvery == 0 ? capture.test : train).push_back(std::move(capture.train[i]));
  }
  capture.train = std::move(train);
}

Capture load_capture(const CaptureOptions& options, Progress& progress) {
  const bool is_file = fs::is_regular_file(options.path);
  const fs::path folder = is_file ? options.path.parent_path() : options.path;
  if (!is_file && !fs::is_directory(folder)) {
    throw InputError(folder, "no such folder; expected a capture");
  }
  const CaptureFormat format =
      options.format == CaptureFormat::kAuto ? detect_format(folder) : options.format;
  RawCapture raw = read_cameras(folder, format);
  keep_evenly(raw.train, options.max_train_views);
  keep_evenly(raw.test, options.max_test_views);
  if (raw.train.empty()) throw InputError(folder, "the capture has no training views");

  // Both splits together, so that the mask check covers all images.
  const size_t train_count = raw.train.size();
  std::vector<RawView> all = std::move(raw.train);
  all.insert(all.end(), raw.test.begin(), raw.test.end());
  progress.begin("images", static_cast<int64_t>(all.size()), 0);
  Loader loader(all, options.max_size, progress);
  std::vector<View> views = loader.run();
  progress.end();

  Capture capture;
  capture.format = format;
  capture.files = raw.files;
  capture.has_masks = agree_on_masks(all, views, loader.masks());
  const auto middle = views.begin() + static_cast<std::ptrdiff_t>(train_count);
  capture.test.assign(std::make_move_iterator(middle), std::make_move_iterator(views.end()));
  views.erase(middle, views.end());
  capture.train = std::move(views);
  normalize_capture(capture, raw.points, folder);
  return capture;
}

}  // namespace tt3d::capture
