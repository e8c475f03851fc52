#pragma once

#include <cstdint>
#include <string>

namespace tt3d::testing {

/// EXIF data (TIFF) that holds only an orientation, in either byte order.
inline std::string exif_data(int orientation, bool little_endian) {
  std::string data = little_endian ? "II" : "MM";
  const auto put = [&](uint32_t value, int size) {
    for (int i = 0; i < size; ++i) {
      data += static_cast<char>(value >> 8 * (little_endian ? i : size - 1 - i));
    }
  };
  put(42, 2);
  put(8, 4);  // where the directory begins
  put(1, 2);  // its entries: tag, type (16 bits), count, value
  put(0x0112, 2);
  put(3, 2);
  put(1, 4);
  put(static_cast<uint32_t>(orientation), 2);
  put(0, 2);
  put(0, 4);  // no other directory
  return data;
}

inline std::string big_endian(size_t value, int size) {
  std::string bytes;
  for (int i = size - 1; i >= 0; --i) bytes += static_cast<char>(value >> 8 * i);
  return bytes;
}

/// A JPEG with EXIF data in its first segment.
inline std::string jpeg_with_exif(std::string jpeg, const std::string& exif) {
  const std::string content = std::string("Exif\0\0", 6) + exif;
  return jpeg.insert(2, "\xFF\xE1" + big_endian(content.size() + 2, 2) + content);
}

/// A PNG with EXIF data in a chunk after the header.
inline std::string png_with_exif(std::string png, const std::string& exif) {
  const std::string chunk = "eXIf" + exif;
  uint32_t crc = 0xFFFFFFFFU;
  for (const char c : chunk) {
    crc ^= static_cast<uint8_t>(c);
    for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1) ^ ((crc & 1) != 0 ? 0xEDB88320U : 0);
  }
  constexpr size_t kAfterHeader = 33;
  return png.insert(kAfterHeader, big_endian(exif.size(), 4) + chunk + big_endian(~crc, 4));
}

}  // namespace tt3d::testing
