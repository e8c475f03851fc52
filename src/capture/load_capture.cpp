#include <ATen/ATen.h>

#include "gains.h"
#include "load_views.h"
#include "mask_files.h"
#include "normalize.h"
#include "raw_view.h"
#include "split.h"
#include "tt3d/memory.h"
#include "upright.h"

namespace tt3d::capture {

namespace {

RawCapture read_cameras(const CaptureSource& source) {
  if (source.format == CaptureFormat::kNerfSynthetic) return read_nerf_synthetic(source);
  if (source.format == CaptureFormat::kNerfstudio) return read_nerfstudio(source);
  return read_colmap(source);
}

void keep_evenly(std::vector<RawView>& views, int count) {
  const size_t keep = static_cast<size_t>(std::max(count, 0));
  if (keep == 0 || keep >= views.size()) return;
  std::vector<RawView> kept;
  for (size_t i = 0; i < keep; ++i) kept.push_back(std::move(views[i * views.size() / keep]));
  views = std::move(kept);
}

/// Either all views have a mask or none has: in a mixture, the training would treat backgrounds as
/// object.
bool agree_on_masks(const std::vector<RawView>& raw, const std::vector<LoadedView>& views) {
  bool transparent = false;
  size_t without = raw.size();
  for (size_t i = 0; i < raw.size(); ++i) {
    if (!views[i].masked) without = std::min(without, i);
    transparent = transparent || views[i].view.rgba.select(2, 3).min().item<uint8_t>() < 255;
  }
  if (!transparent) return false;
  if (without < raw.size()) {
    throw InputError(raw[without].image,
                     "has neither alpha nor a mask file, but other images of the capture do; "
                     "expected " +
                         MaskFiles::expected_names(raw[without]));
  }
  return true;
}

/// Masks with black as the object are valid files; only the place of the object gives them away.
void note_polarity(const std::vector<LoadedView>& views, Progress& progress) {
  size_t count = 0;
  for (const LoadedView& loaded : views) count += loaded.object_at_border ? 1 : 0;
  if (2 * count <= views.size()) return;
  progress.note("in " + std::to_string(count) + " of " + std::to_string(views.size()) +
                " views the masks mark the border of the picture as object; white (or alpha) must "
                "be the object and black the background, so invert the masks if they are the "
                "other way round");
}

/// The notes about masks that are valid, but probably not what the user means.
void note_masks(const std::vector<RawView>& raw, const std::vector<LoadedView>& views,
                bool has_masks, Progress& progress) {
  const bool files = !raw[0].mask.empty();
  if (has_masks) note_polarity(views, progress);
  if (files && !has_masks) {
    progress.note(
        "the mask files mark every pixel of every view as object; the capture is read "
        "without masks");
  }
}

/// Every file of the capture that is read: cameras, pictures, masks.
std::vector<std::string> files_of(std::vector<std::string> files, const std::vector<RawView>& all) {
  for (const RawView& view : all) {
    for (const std::filesystem::path& path : {view.image, view.mask}) {
      if (!path.empty()) files.push_back(absolute_name(path));
    }
  }
  return files;
}

/// All cameras of a capture, split into training and test views, with their mask files.
RawCapture read_views(const CaptureOptions& options, const CaptureSource& source) {
  RawCapture raw = read_cameras(source);
  raw.notes.insert(raw.notes.begin(), source.notes.begin(), source.notes.end());
  split_off_test(raw);
  check_disjoint(raw);
  keep_evenly(raw.train, options.max_train_views);
  keep_evenly(raw.test, options.max_test_views);
  if (raw.train.empty()) throw InputError(options.path, "the capture has no training views");
  return raw;
}

}  // namespace

Capture load_capture(const CaptureOptions& options, Progress& progress) {
  const CaptureSource source = find_source(options);
  RawCapture raw = read_views(options, source);
  for (const std::string& line : raw.notes) progress.note(line);
  Capture capture;
  capture.normalization.up = up_of_capture(options.up, source.format, raw, progress);
  // Both splits together, so that the checks of masks cover all images.
  const size_t train_count = raw.train.size();
  std::vector<RawView> all = std::move(raw.train);
  all.insert(all.end(), raw.test.begin(), raw.test.end());
  MaskFiles(source.folder).assign(all);
  std::vector<LoadedView> views = load_views(all, options.max_size, free_memory_bytes(), progress);

  capture.format = source.format;
  capture.files = files_of(raw.files, all);
  capture.has_gains = apply_gains(source.folder, all, views);
  if (capture.has_gains) capture.files.push_back(absolute_name(source.folder / "gains.json"));
  capture.has_masks = agree_on_masks(all, views);
  note_masks(all, views, capture.has_masks, progress);
  for (size_t i = 0; i < views.size(); ++i) {
    (i < train_count ? capture.train : capture.test).push_back(std::move(views[i].view));
  }
  normalize_capture(capture, raw.points, source.folder);
  return capture;
}

}  // namespace tt3d::capture
