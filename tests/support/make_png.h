#pragma once

#include <png.h>

#include <string>
#include <vector>

namespace tt3d::testing {

/// A PNG made with libpng's full interface: any colour type and bit depth, palette and tRNS.
inline std::string make_png(int colour_type, int bit_depth, int width,
                            const std::vector<std::string>& rows,
                            const std::string& transparency = "",
                            const std::vector<png_color>& palette = {{10, 20, 30},
                                                                     {200, 150, 100}}) {
  std::string bytes;
  png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, nullptr, nullptr, nullptr);
  png_infop info = png_create_info_struct(png);
  png_set_write_fn(
      png, &bytes,
      [](png_structp p, png_bytep data, size_t size) {
        static_cast<std::string*>(png_get_io_ptr(p))->append(reinterpret_cast<char*>(data), size);
      },
      nullptr);
  png_set_IHDR(png, info, static_cast<png_uint_32>(width), static_cast<png_uint_32>(rows.size()),
               bit_depth, colour_type, PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT,
               PNG_FILTER_TYPE_DEFAULT);
  if (colour_type == PNG_COLOR_TYPE_PALETTE) {
    png_set_PLTE(png, info, palette.data(), static_cast<int>(palette.size()));
  }
  if (!transparency.empty()) {
    png_set_tRNS(png, info, reinterpret_cast<png_const_bytep>(transparency.data()),
                 static_cast<int>(transparency.size()), nullptr);
  }
  png_write_info(png, info);
  for (const std::string& row : rows) {
    png_write_row(png, reinterpret_cast<png_const_bytep>(row.data()));
  }
  png_write_end(png, info);
  png_destroy_write_struct(&png, &info);
  return bytes;
}

}  // namespace tt3d::testing
