#include <ATen/ATen.h>
#include <ATen/Parallel.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "tt3d/capture.h"
#include "tt3d/linear.h"

/// Judgement of a capture: do the masks agree in space, do the cameras see the object from all
/// sides, are the photographs sharp and evenly exposed.
namespace tt3d::capture {

using namespace scene::linear;

namespace {

constexpr double kDegree = std::numbers::pi / 180;
constexpr int kSide = 128;      ///< pixels, longer side of the masks that are compared
constexpr int kVoxels = 72;     ///< side of the voting grid
constexpr double kAgree = 0.8;  ///< fraction of the views that make a voxel object
constexpr double kGood = 0.80;  ///< overlap of a good mask with the hull
constexpr double kFar = 0.10;   ///< overlap below the median that is an outlier
constexpr int kObjectAlpha = 128;

/// A mask at a small size.
struct SmallMask {
  int width = 0, height = 0;
  double scale = 1;  ///< small pixels over pixels
  std::vector<uint8_t> object;
  [[nodiscard]] double share() const {
    return static_cast<double>(std::count(object.begin(), object.end(), 1)) /
           static_cast<double>(object.size());
  }
};

SmallMask small_mask(const View& view) {
  SmallMask mask;
  mask.scale =
      std::min(1.0, static_cast<double>(kSide) / std::max(view.camera.width, view.camera.height));
  mask.width = std::max(1, static_cast<int>(std::lround(view.camera.width * mask.scale)));
  mask.height = std::max(1, static_cast<int>(std::lround(view.camera.height * mask.scale)));
  const at::Tensor alpha =
      view.rgba.select(2, 3).to(at::kFloat).view({1, 1, view.rgba.size(0), view.rgba.size(1)});
  const at::Tensor small =
      at::adaptive_avg_pool2d(alpha, {mask.height, mask.width}).flatten().contiguous();
  const float* values = small.const_data_ptr<float>();
  mask.object.resize(static_cast<size_t>(small.numel()));
  for (size_t i = 0; i < mask.object.size(); ++i) mask.object[i] = values[i] >= kObjectAlpha;
  return mask;
}

/// The small pixel of a world point; -1 if the view does not show it.
int64_t pixel_of(const View& view, const SmallMask& mask, const Vec3& point) {
  const Vec3 local = to_local(view.camera.camera_to_world, point);
  if (local[2] >= -1e-6) return -1;
  const double u = (view.camera.cx - view.camera.fx * local[0] / local[2]) * mask.scale;
  const double v = (view.camera.cy + view.camera.fy * local[1] / local[2]) * mask.scale;
  if (u < 0 || v < 0 || u >= mask.width || v >= mask.height) return -1;
  return static_cast<int64_t>(v) * mask.width + static_cast<int64_t>(u);
}

Vec3 voxel(int64_t index, double reach) {
  const double step = 2 * reach / kVoxels;
  Vec3 point;
  for (size_t k = 0; k < 3; ++k, index /= kVoxels) {
    point[k] = (static_cast<double>(index % kVoxels) + 0.5) * step - reach;
  }
  return point;
}

/// The voxels that most views, among those that show them, call object.
std::vector<Vec3> agreed_voxels(const std::vector<const View*>& views,
                                const std::vector<SmallMask>& masks, double reach) {
  constexpr int64_t kTotal = int64_t{kVoxels} * kVoxels * kVoxels;
  std::vector<uint8_t> kept(kTotal);
  at::parallel_for(0, kTotal, 4096, [&](int64_t first, int64_t last) {
    for (int64_t i = first; i < last; ++i) {
      const Vec3 point = voxel(i, reach);
      int seen = 0, yes = 0;
      for (size_t k = 0; k < views.size(); ++k) {
        const int64_t at = pixel_of(*views[k], masks[k], point);
        if (at < 0) continue;
        ++seen;
        yes += masks[k].object[static_cast<size_t>(at)];
      }
      kept[static_cast<size_t>(i)] =
          2 * seen >= static_cast<int>(views.size()) && yes >= kAgree * seen;
    }
  });
  std::vector<Vec3> points;
  for (int64_t i = 0; i < kTotal; ++i) {
    if (kept[static_cast<size_t>(i)] != 0) points.push_back(voxel(i, reach));
  }
  return points;
}

/// The picture of the voxels, each drawn as a square of its size.
std::vector<uint8_t> silhouette(const View& view, const SmallMask& mask,
                                const std::vector<Vec3>& voxels, double size) {
  std::vector<uint8_t> out(mask.object.size());
  for (const Vec3& point : voxels) {
    const int64_t at = pixel_of(view, mask, point);
    if (at < 0) continue;
    const double depth = -to_local(view.camera.camera_to_world, point)[2];
    const auto reach =
        static_cast<int64_t>(std::floor(0.5 * size * view.camera.fx * mask.scale / depth));
    const int64_t x = at % mask.width, y = at / mask.width;
    for (int64_t r = std::max<int64_t>(0, y - reach);
         r <= std::min<int64_t>(mask.height - 1, y + reach); ++r) {
      for (int64_t c = std::max<int64_t>(0, x - reach);
           c <= std::min<int64_t>(mask.width - 1, x + reach); ++c) {
        out[static_cast<size_t>(r * mask.width + c)] = 1;
      }
    }
  }
  return out;
}

double overlap(const std::vector<uint8_t>& a, const std::vector<uint8_t>& b, bool invert = false) {
  if (a.size() != b.size()) return 0;
  int64_t both = 0, any = 0;
  for (size_t i = 0; i < a.size(); ++i) {
    const bool first = (a[i] != 0) != invert;
    both += first && b[i] != 0;
    any += first || b[i] != 0;
  }
  return any == 0 ? 1 : static_cast<double>(both) / static_cast<double>(any);
}

double median(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// Sharpness and brightness of the object. Sharpness: how much the strongest slopes lose when the
/// picture is blurred (Crete et al., The Blur Effect, 2007).
void measure_pixels(const View& view, ViewQuality& quality) {
  const at::Tensor rgba = view.rgba.to(at::kFloat) / 255;
  const at::Tensor grey = rgba.narrow(2, 0, 3).mean(2);
  const at::Tensor object = rgba.select(2, 3) >= 0.5;
  if (object.sum().item<int64_t>() < 100) return;
  quality.brightness = grey.masked_select(object).mean().item<double>();
  const at::Tensor picture = grey.view({1, 1, grey.size(0), grey.size(1)});
  const at::Tensor blurred = at::avg_pool2d(picture, {5, 5}, {1, 1}, {2, 2});
  const auto slope = [](const at::Tensor& t) {
    const int64_t h = t.size(2) - 1, w = t.size(3) - 1;
    const at::Tensor corner = t.narrow(2, 0, h).narrow(3, 0, w);
    return (t.narrow(2, 1, h).narrow(3, 0, w) - corner).abs() +
           (t.narrow(2, 0, h).narrow(3, 1, w) - corner).abs();
  };
  const at::Tensor inside = object.narrow(0, 0, grey.size(0) - 1)
                                .narrow(1, 0, grey.size(1) - 1)
                                .unsqueeze(0)
                                .unsqueeze(0);
  const at::Tensor before = slope(picture).masked_select(inside);
  const at::Tensor after = slope(blurred).masked_select(inside);
  const int64_t count = std::max<int64_t>(1, before.numel() / 20);
  const auto [strong, index] = before.topk(count);
  quality.sharpness =
      1 - after.index_select(0, index).sum().item<double>() / (strong.sum().item<double>() + 1e-9);
}

void judge_masks(const std::vector<const View*>& views, const std::vector<SmallMask>& masks,
                 double reach, CaptureQuality& quality) {
  const std::vector<Vec3> voxels = agreed_voxels(views, masks, reach);
  std::vector<std::vector<uint8_t>> hulls;
  std::vector<double> overlaps;
  for (size_t i = 0; i < views.size(); ++i) {
    hulls.push_back(silhouette(*views[i], masks[i], voxels, 2 * reach / kVoxels));
    quality.views[i].hull_overlap = overlap(masks[i].object, hulls[i]);
    overlaps.push_back(quality.views[i].hull_overlap);
  }
  quality.hull_overlap = median(overlaps);
  const double least = std::min(kGood, quality.hull_overlap - kFar);
  for (size_t i = 0; i < views.size(); ++i) {
    ViewQuality& view = quality.views[i];
    if (masks[i].share() == 0) {
      view.problem = "its mask is empty";
    } else if (overlap(masks[i].object, hulls[i], /*invert=*/true) > view.hull_overlap) {
      view.problem = "its mask is inverted: the object must be white";
    } else if (view.hull_overlap < least) {
      view.problem = "its mask does not fit the others: shifted, or of another photograph";
      for (size_t k = 0; k < views.size(); ++k) {
        const double other = overlap(masks[k].object, hulls[i]);
        if (k != i && other > view.hull_overlap + 2 * kFar && other > least) {
          view.problem = "its mask may be that of " + views[k]->name;
          if (overlap(masks[i].object, hulls[k]) > least) break;
        }
      }
    }
  }
}

void judge_cameras(const std::vector<const View*>& views, CaptureQuality& quality) {
  std::vector<double> azimuths;
  quality.lowest_deg = 90;
  quality.highest_deg = -90;
  std::vector<Vec3> directions;
  for (size_t i = 0; i < views.size(); ++i) {
    const Vec3 p = views[i]->camera.position();
    if (length(p) < 1e-9) continue;
    directions.push_back(normalized(p));
    ViewQuality& view = quality.views[i];
    view.elevation_deg = std::asin(std::clamp(directions.back()[2], -1.0, 1.0)) / kDegree;
    view.azimuth_deg = std::atan2(p[1], p[0]) / kDegree;
    azimuths.push_back(view.azimuth_deg);
    quality.lowest_deg = std::min(quality.lowest_deg, view.elevation_deg);
    quality.highest_deg = std::max(quality.highest_deg, view.elevation_deg);
  }
  std::sort(azimuths.begin(), azimuths.end());
  for (size_t i = 0; i < azimuths.size(); ++i) {
    const double next = i + 1 < azimuths.size() ? azimuths[i + 1] : azimuths[0] + 360;
    quality.largest_gap_deg = std::max(quality.largest_gap_deg, next - azimuths[i]);
  }
  double seen = 0, total = 0;
  constexpr double kStep = 5, kHighest = 75, kNear = 25;
  for (double elevation = 2.5; elevation < kHighest; elevation += kStep) {
    for (double azimuth = 0; azimuth < 360; azimuth += kStep) {
      const double e = elevation * kDegree, a = azimuth * kDegree;
      const Vec3 d = {std::cos(e) * std::cos(a), std::cos(e) * std::sin(a), std::sin(e)};
      const bool near = std::any_of(directions.begin(), directions.end(), [&](const Vec3& v) {
        return dot(v, d) > std::cos(kNear * kDegree);
      });
      seen += near ? std::cos(e) : 0;
      total += std::cos(e);
    }
  }
  quality.coverage = seen / total;
}

/// Plain advice for what falls outside what good captures have.
void advise(const Capture& capture, CaptureQuality& quality) {
  const auto say = [&](const std::string& line) { quality.advice.push_back(line); };
  if (!capture.has_masks) {
    say("there are no masks; make them with 'tt3d photos', or paint them");
  }
  for (const ViewQuality& view : quality.views) {
    if (!view.problem.empty()) say(view.name + ": " + view.problem);
  }
  if (capture.has_masks && quality.hull_overlap < kGood) {
    say("the masks agree badly with each other; look at them, and paint the bad ones");
  }
  if (quality.views.size() < 25) {
    say("there are only " + std::to_string(quality.views.size()) +
        " photographs; 30 to 60 give a better object");
  }
  if (quality.largest_gap_deg > 45) {
    say("no camera sees " + std::to_string(std::lround(quality.largest_gap_deg)) +
        " degrees of the way around the object; add photographs from there");
  }
  if (quality.highest_deg < 35) {
    say("no camera looks down from above 35 degrees; the top of the object is a guess");
  }
  if (quality.exposure_spread > 0.35 && !capture.has_gains) {
    say("the exposure changes between the photographs; lock it, or let 'tt3d photos' even it");
  }
  if (quality.sharpness < 0.3) {
    say("the photographs are not sharp; use more light and a steady hand");
  }
}

}  // namespace

CaptureQuality assess_capture(const Capture& capture, Progress& progress) {
  std::vector<const View*> views;
  for (const auto* list : {&capture.train, &capture.test}) {
    for (const View& view : *list) views.push_back(&view);
  }
  CaptureQuality quality;
  std::vector<SmallMask> masks;
  std::vector<double> sharp, levels;
  for (const View* view : views) {
    progress.check();
    ViewQuality one;
    one.name = view->name;
    masks.push_back(small_mask(*view));
    one.mask_share = masks.back().share();
    measure_pixels(*view, one);
    if (one.brightness > 0) {
      sharp.push_back(one.sharpness);
      levels.push_back(std::log2(one.brightness));
    }
    quality.views.push_back(one);
  }
  quality.sharpness = median(sharp);
  double mean = 0, square = 0;
  for (const double level : levels) mean += level / static_cast<double>(levels.size());
  for (const double level : levels) square += (level - mean) * (level - mean);
  if (!levels.empty()) {
    quality.exposure_spread = std::sqrt(square / static_cast<double>(levels.size()));
  }
  constexpr double kMargin = 1.1;
  if (capture.has_masks) judge_masks(views, masks, kMargin * capture.object_radius, quality);
  judge_cameras(views, quality);
  advise(capture, quality);
  return quality;
}

}  // namespace tt3d::capture
