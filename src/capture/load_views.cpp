#include "load_views.h"

#include <ATen/ATen.h>

#include <atomic>
#include <exception>
#include <thread>

#include "camera.h"
#include "mask.h"
#include "resample.h"
#include "tt3d/image.h"
#include "tt3d/scene.h"

namespace tt3d::capture {

namespace {

/// Number of threads that decode views; each holds one full-size image.
constexpr int kLoaderThreads = 2;
/// Memory that training needs for a photograph, in multiples of its 8-bit pixels: the photograph,
/// the copy of its pixels that rays are drawn from, and their indices, twice while they are joined.
constexpr int64_t kCopies = 4;

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

/// Multiplies the alpha of an image by its mask file.
void apply_mask(at::Tensor& rgba, const RawView& raw) {
  const at::Tensor mask = read_mask(raw.mask);
  if (mask.size(0) != rgba.size(0) || mask.size(1) != rgba.size(1)) {
    throw InputError(raw.mask,
                     "is " + std::to_string(mask.size(1)) + "x" + std::to_string(mask.size(0)) +
                         " pixels, expected the size of its image " + raw.name + ", " +
                         std::to_string(rgba.size(1)) + "x" + std::to_string(rgba.size(0)));
  }
  const uint8_t* m = mask.const_data_ptr<uint8_t>();
  uint8_t* p = rgba.data_ptr<uint8_t>();
  for (int64_t i = 0; i < mask.numel(); ++i, p += 4) {
    p[3] = static_cast<uint8_t>((p[3] * m[i] + 127) / 255);
  }
}

LoadedView load_view(const RawView& raw, int max_size) {
  LoadedView loaded;
  View& view = loaded.view;
  view.name = raw.name;
  view.camera = raw.camera;
  view.rgba = image::read_image(raw.image);
  complete_camera(raw, static_cast<int>(view.rgba.size(1)), static_cast<int>(view.rgba.size(0)),
                  view.camera);
  if (!raw.mask.empty()) apply_mask(view.rgba, raw);
  loaded.masked = !raw.mask.empty() || image::image_has_alpha(raw.image);
  loaded.object_at_border = object_at_border(view.rgba);
  if (!raw.distortion.none()) {
    view.rgba = undistort(view.rgba, view.camera, raw.distortion, loaded.masked);
  }
  limit_size(view, max_size);
  return loaded;
}

std::string gibibytes(int64_t bytes) {
  const int64_t tenths = (bytes * 10 + (int64_t{1} << 29)) >> 30;
  return std::to_string(tenths / 10) + "." + std::to_string(tenths % 10) + " GiB";
}

/// Loads views on a few threads, and reports progress from the calling thread.
class Loader {
 public:
  Loader(const std::vector<RawView>& raw, int max_size, int64_t free_bytes, Progress& progress)
      : raw_(raw),
        max_size_(max_size),
        free_bytes_(free_bytes),
        progress_(progress),
        views_(raw.size()),
        errors_(raw.size()) {}

  std::vector<LoadedView> run() {
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

 private:
  void work(bool report) {
    for (size_t i = next_++; i < raw_.size() && !stop_; i = next_++) {
      try {
        views_[i] = load_view(raw_[i], max_size_);
        count_bytes(static_cast<int64_t>(views_[i].view.rgba.nbytes()));
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

  /// Adds the bytes of a loaded view. Fails once the loaded views alone need too much.
  void count_bytes(int64_t bytes) {
    const int64_t sum = bytes_ += bytes;
    if (sum <= free_bytes_ / kCopies) return;
    const int64_t loaded = done_ + 1;
    const int64_t total = sum / loaded * static_cast<int64_t>(raw_.size()) * kCopies;
    throw ResourceError(std::to_string(raw_.size()) + " photographs need about " +
                        gibibytes(std::max(total, sum * kCopies)) + " of memory, and " +
                        gibibytes(free_bytes_) +
                        " are free; lower capture.max_size or capture.max_train_views");
  }

  const std::vector<RawView>& raw_;
  int max_size_;
  int64_t free_bytes_;
  Progress& progress_;
  std::vector<LoadedView> views_;
  std::vector<std::exception_ptr> errors_;
  std::atomic<size_t> next_ = 0;
  std::atomic<int64_t> done_ = 0;
  std::atomic<int64_t> bytes_ = 0;
  std::atomic<bool> stop_ = false;
};

}  // namespace

std::vector<LoadedView> load_views(const std::vector<RawView>& raw, int max_size,
                                   int64_t free_bytes, Progress& progress) {
  progress.begin("images", static_cast<int64_t>(raw.size()), 0);
  std::vector<LoadedView> views = Loader(raw, max_size, free_bytes, progress).run();
  progress.end();
  return views;
}

}  // namespace tt3d::capture
