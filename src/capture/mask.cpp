#include "mask.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <array>
#include <set>

#include "tt3d/error.h"
#include "tt3d/pictures.h"

namespace tt3d::capture {
namespace {

using at::Tensor;

constexpr size_t kFewColours = 32;  ///< labels have at most so many colours
constexpr int kFewLevels = 8;       ///< label masks in grey have at most so many levels ...
constexpr int kSmallLabel = 20;     ///< ... or none above this
constexpr int kJpegBlack = 32;      ///< compression leaves black pixels below this level
constexpr int kLargestTones = 12;   ///< a coloured mask has at most so many frequent tones
constexpr uint32_t kWhite = 0xFFFFFF;

/// What decides how a mask is read. The level of a pixel is the largest of red, green and blue.
struct MaskFacts {
  std::array<int64_t, 256> levels{};  ///< pixels of each level
  std::array<int64_t, 512> tones{};   ///< pixels of each colour, 3 bits a channel
  std::set<uint32_t> colours;  ///< of pixels that are not transparent; stops at kFewColours + 1
  int64_t pixels = 0;
  int64_t coloured = 0;      ///< pixels that are not grey
  bool transparent = false;  ///< some pixels are

  [[nodiscard]] int lowest() const {
    return static_cast<int>(std::find_if(levels.begin(), levels.end(), is_used) - levels.begin());
  }
  [[nodiscard]] int highest() const {
    return 255 - static_cast<int>(std::find_if(levels.rbegin(), levels.rend(), is_used) -
                                  levels.rbegin());
  }
  [[nodiscard]] int64_t count() const {
    return std::count_if(levels.begin(), levels.end(), is_used);
  }
  /// Pixels of the levels [first, last].
  [[nodiscard]] int64_t between(int first, int last) const {
    int64_t sum = 0;
    for (int level = first; level <= last; ++level) sum += levels[static_cast<size_t>(level)];
    return sum;
  }

 private:
  static bool is_used(int64_t pixels_of_level) { return pixels_of_level > 0; }
};

uint8_t level_of(const uint8_t* rgba) { return std::max({rgba[0], rgba[1], rgba[2]}); }

MaskFacts facts_of(const Tensor& rgba, bool exact) {
  const int tolerance = exact ? 8 : 48;
  MaskFacts facts;
  facts.pixels = rgba.size(0) * rgba.size(1);
  const auto* p = rgba.const_data_ptr<uint8_t>();
  for (int64_t i = 0; i < facts.pixels; ++i, p += 4) {
    facts.transparent = facts.transparent || p[3] < 255;
    if (p[3] == 0) continue;
    const int level = level_of(p);
    ++facts.levels[static_cast<size_t>(level)];
    facts.coloured += level - std::min({p[0], p[1], p[2]}) > tolerance ? 1 : 0;
    ++facts.tones[static_cast<size_t>((p[0] >> 5) << 6 | (p[1] >> 5) << 3 | p[2] >> 5)];
    if (facts.colours.size() > kFewColours) continue;
    facts.colours.insert(static_cast<uint32_t>(p[0] << 16 | p[1] << 8 | p[2]));
  }
  return facts;
}

/// The opacity of each pixel: `opacity` of its level, times its alpha.
Tensor by_level(const Tensor& rgba, const std::array<uint8_t, 256>& opacity) {
  Tensor mask = at::empty({rgba.size(0), rgba.size(1)}, at::kByte);
  auto* out = mask.mutable_data_ptr<uint8_t>();
  const auto* p = rgba.const_data_ptr<uint8_t>();
  for (int64_t i = 0; i < mask.numel(); ++i, p += 4) {
    out[i] = static_cast<uint8_t>((opacity[level_of(p)] * p[3] + 127) / 255);
  }
  return mask;
}

Tensor from_threshold(const Tensor& rgba, int threshold) {
  std::array<uint8_t, 256> opacity{};
  std::fill(opacity.begin() + threshold, opacity.end(), uint8_t{255});
  return by_level(rgba, opacity);
}

/// The alpha channel is the mask, be it a cut-out photograph or a stencil of any colour. Only
/// black and white beside the transparent pixels are a mask of their own.
Tensor from_alpha(const Tensor& rgba, const MaskFacts& facts) {
  if (facts.colours == std::set<uint32_t>{0, kWhite}) return from_threshold(rgba, 128);
  return rgba.select(2, 3).contiguous();
}

/// A grey picture without compression errors: labels, or opacity from 0 to 255.
Tensor from_grey(const Tensor& rgba, const MaskFacts& facts, const std::filesystem::path& path) {
  const bool few = facts.count() <= kFewLevels;
  const int highest = facts.highest();
  const bool labels = highest <= kSmallLabel || (few && highest < 255);
  if (labels && facts.lowest() > 0 && facts.count() > 1) {
    throw InputError(path, "has labels, but no pixel has label 0; expected 0 for the background");
  }
  if (few && highest == 255 && facts.between(kSmallLabel + 1, 254) == 0 &&
      facts.between(1, kSmallLabel) > facts.pixels / 100) {
    throw InputError(path,
                     "has small labels and also the value 255; expected 0 for the background and "
                     "255 for the object");
  }
  if (labels) return from_threshold(rgba, 1);
  std::array<uint8_t, 256> same{};
  for (size_t level = 0; level < same.size(); ++level) same[level] = static_cast<uint8_t>(level);
  return by_level(rgba, same);
}

/// The level from which a pixel of a JPEG belongs to the object.
Tensor from_grey_jpeg(const Tensor& rgba, const MaskFacts& facts,
                      const std::filesystem::path& path) {
  const int highest = facts.highest();
  if (highest > 8 && highest < 2 * kJpegBlack) {
    throw InputError(path, "is a nearly black JPEG; expected a mask with white as the object");
  }
  return from_threshold(rgba, std::max(kJpegBlack, (highest + 1) / 2));
}

/// A coloured picture: black is the background, and every other colour is an object.
Tensor from_colours(const Tensor& rgba, const MaskFacts& facts, bool exact,
                    const std::filesystem::path& path) {
  const bool labels = exact && facts.colours.size() <= kFewColours;
  if (facts.between(0, labels ? 0 : kJpegBlack - 1) == 0) {
    throw InputError(path,
                     "is a coloured mask without black; expected black as the background and "
                     "white, or any colour, as the object");
  }
  if (labels) return from_threshold(rgba, 1);
  const int64_t frequent = std::count_if(facts.tones.begin() + 1, facts.tones.end(),
                                         [&](int64_t n) { return n > facts.pixels / 200; });
  if (frequent > kLargestTones) {
    throw InputError(path,
                     "looks like a photograph, not a mask; expected white as the object and black "
                     "as the background");
  }
  return from_threshold(rgba, std::min(2 * kJpegBlack, (facts.highest() + 1) / 2));
}

}  // namespace

Tensor read_mask(const std::filesystem::path& path) {
  const image::LabelPicture picture = image::read_label_picture(path);
  const Tensor rgba = picture.rgba.contiguous();
  const MaskFacts facts = facts_of(rgba, picture.exact);
  if (facts.transparent) return from_alpha(rgba, facts);
  if (picture.labels) return from_threshold(rgba, 1);
  // The compression of a JPEG colours a few pixels.
  if (facts.coloured > (picture.exact ? 0 : facts.pixels / 1000)) {
    return from_colours(rgba, facts, picture.exact, path);
  }
  return picture.exact ? from_grey(rgba, facts, path) : from_grey_jpeg(rgba, facts, path);
}

bool object_at_border(const Tensor& rgba) {
  constexpr double kMost = 0.6;
  const Tensor object = rgba.select(2, 3).ge(128);
  const int64_t border =
      object.select(0, 0).sum().item<int64_t>() + object.select(0, -1).sum().item<int64_t>() +
      object.select(1, 0).sum().item<int64_t>() + object.select(1, -1).sum().item<int64_t>();
  return static_cast<double>(border) > kMost * 2 * static_cast<double>(rgba.size(0) + rgba.size(1));
}

}  // namespace tt3d::capture
