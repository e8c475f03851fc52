#include <cstdint>
#include <string_view>

#include "codec.h"
#include "tt3d/pictures.h"

// The orientation in EXIF data (CIPA DC-008): a TIFF directory in the APP1 segment of a JPEG, or in
// the eXIf chunk of a PNG. Whatever is damaged counts as absent: the pixels are still readable.

namespace tt3d::image {
namespace {

/// Unsigned numbers at byte offsets; 0 beyond the end.
struct Numbers {
  std::string_view bytes;
  bool little_endian = false;

  [[nodiscard]] uint32_t at(size_t offset, size_t size) const {
    if (offset > bytes.size() || size > bytes.size() - offset) return 0;
    uint32_t value = 0;
    for (size_t i = 0; i < size; ++i) {
      const auto byte =
          static_cast<unsigned char>(bytes[offset + (little_endian ? size - 1 - i : i)]);
      value = value << 8 | byte;
    }
    return value;
  }
};

/// The bytes [offset, offset + size), as far as they exist.
std::string_view part(std::string_view bytes, size_t offset, size_t size) {
  return offset < bytes.size() ? bytes.substr(offset, size) : std::string_view();
}

/// The orientation tag of the first directory; 1 if there is none.
int tiff_orientation(std::string_view tiff) {
  constexpr uint32_t kOrientation = 0x0112;
  constexpr size_t kEntryBytes = 12;
  const Numbers numbers{tiff, tiff.starts_with("II")};
  if (numbers.at(2, 2) != 42) return 1;
  const size_t directory = numbers.at(4, 4);
  const size_t entries = numbers.at(directory, 2);
  for (size_t i = 0; i < entries && directory + i * kEntryBytes < tiff.size(); ++i) {
    const size_t entry = directory + 2 + i * kEntryBytes;
    if (numbers.at(entry, 2) != kOrientation) continue;
    const uint32_t value = numbers.at(entry + 8, 2);
    return value >= 1 && value <= 8 ? static_cast<int>(value) : 1;
  }
  return 1;
}

/// The TIFF data of the first EXIF segment of a JPEG.
std::string_view jpeg_exif(std::string_view bytes) {
  constexpr std::string_view kName("Exif\0\0", 6);
  constexpr unsigned char kApp1 = 0xE1, kStartOfScan = 0xDA, kFill = 0xFF;
  const Numbers numbers{bytes};
  size_t at = 2;
  while (at + 4 <= bytes.size() && numbers.at(at, 1) == 0xFF) {
    const uint32_t marker = numbers.at(at + 1, 1);
    if (marker == kFill) {
      ++at;
      continue;
    }
    if (marker == kStartOfScan) break;
    const size_t size = numbers.at(at + 2, 2);
    const std::string_view segment = part(bytes, at + 4, size < 2 ? 0 : size - 2);
    if (marker == kApp1 && segment.starts_with(kName)) return segment.substr(kName.size());
    at += 2 + size;
  }
  return {};
}

/// The content of the eXIf chunk of a PNG.
std::string_view png_exif(std::string_view bytes) {
  constexpr size_t kSignature = 8, kChunkFrame = 12;
  const Numbers numbers{bytes};
  for (size_t at = kSignature; at + kChunkFrame <= bytes.size();) {
    const size_t size = numbers.at(at, 4);
    if (part(bytes, at + 4, 4) == "eXIf") return part(bytes, at + 8, size);
    at += kChunkFrame + size;
  }
  return {};
}

}  // namespace

int exif_orientation(std::string_view bytes) {
  if (is_jpeg(bytes)) return tiff_orientation(jpeg_exif(bytes));
  if (is_png(bytes)) return tiff_orientation(png_exif(bytes));
  return 1;
}

}  // namespace tt3d::image
