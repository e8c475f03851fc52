#include <ATen/ATen.h>
#include <png.h>

#include <csetjmp>
#include <cstring>
#include <vector>

#include "codec.h"
#include "tt3d/core.h"

// libpng reports errors by longjmp. Functions that call setjmp hold no object with a destructor.
// Memory belongs to PngReader, which their callers own.

namespace tt3d::image {
namespace {

/// A libpng reader of bytes in memory, with the message of the last error.
struct PngReader {
  png_structp png = nullptr;
  png_infop info = nullptr;
  std::string_view bytes;
  size_t position = 0;
  char message[160] = "not a valid PNG file";

  explicit PngReader(std::string_view data);
  ~PngReader() { png_destroy_read_struct(&png, &info, nullptr); }
  PngReader(const PngReader&) = delete;
  PngReader& operator=(const PngReader&) = delete;
};

extern "C" void png_on_error(png_structp png, png_const_charp text) {
  auto* reader = static_cast<PngReader*>(png_get_error_ptr(png));
  std::strncpy(reader->message, text, sizeof reader->message - 1);
  png_longjmp(png, 1);
}

extern "C" void png_on_warning(png_structp, png_const_charp) {}

extern "C" void png_read_bytes(png_structp png, png_bytep out, size_t size) {
  auto* reader = static_cast<PngReader*>(png_get_io_ptr(png));
  if (size > reader->bytes.size() - reader->position) png_error(png, "the file is truncated");
  std::memcpy(out, reader->bytes.data() + reader->position, size);
  reader->position += size;
}

PngReader::PngReader(std::string_view data) : bytes(data) {
  png = png_create_read_struct(PNG_LIBPNG_VER_STRING, this, png_on_error, png_on_warning);
  info = png == nullptr ? nullptr : png_create_info_struct(png);
  if (info == nullptr) throw ResourceError("out of memory while reading a PNG image");
  png_set_read_fn(png, this, png_read_bytes);
}

/// Reads up to the first pixel data.
bool read_header(PngReader& reader) {
  if (setjmp(png_jmpbuf(reader.png)) != 0) return false;
  png_read_info(reader.png, reader.info);
  return true;
}

/// Sets up the conversion to RGBA and updates the info struct: to 8 bits, or, for a 16-bit file, to
/// 16 bits if `keep_16`.
bool prepare_rgba(PngReader& reader, bool keep_16) {
  if (setjmp(png_jmpbuf(reader.png)) != 0) return false;
  png_set_expand(reader.png);
  if (!keep_16) png_set_scale_16(reader.png);
  png_set_gray_to_rgb(reader.png);
  png_set_add_alpha(reader.png, keep_16 ? 0xFFFF : 0xFF, PNG_FILLER_AFTER);
  png_set_interlace_handling(reader.png);
  png_read_update_info(reader.png, reader.info);
  return true;
}

bool read_rows(PngReader& reader, png_bytepp rows) {
  if (setjmp(png_jmpbuf(reader.png)) != 0) return false;
  png_read_image(reader.png, rows);
  png_read_end(reader.png, nullptr);
  return true;
}

[[noreturn]] void throw_png_error(const PngReader& reader, const std::filesystem::path& name) {
  throw InputError(
      name, std::string("cannot decode the PNG image: ") + reader.message + "; replace the file");
}

/// Reads all pixels as RGBA into rows of `row_bytes`.
void read_rgba(PngReader& reader, bool keep_16, int64_t row_bytes, uint8_t* pixels,
               const std::filesystem::path& name) {
  if (!prepare_rgba(reader, keep_16)) throw_png_error(reader, name);
  std::vector<png_bytep> rows(png_get_image_height(reader.png, reader.info));
  for (size_t y = 0; y < rows.size(); ++y) {
    rows[y] = pixels + static_cast<int64_t>(y) * row_bytes;
  }
  if (!read_rows(reader, rows.data())) throw_png_error(reader, name);
}

}  // namespace

bool is_png(std::string_view bytes) {
  return bytes.size() >= 8 &&
         png_sig_cmp(reinterpret_cast<png_const_bytep>(bytes.data()), 0, 8) == 0;
}

at::Tensor decode_png(std::string_view bytes, const std::filesystem::path& name) {
  PngReader reader(bytes);
  if (!read_header(reader)) throw_png_error(reader, name);
  const int64_t width = png_get_image_width(reader.png, reader.info);
  const int64_t height = png_get_image_height(reader.png, reader.info);
  check_image_size(width, height, name);
  at::Tensor image = at::empty({height, width, 4}, at::kByte);
  read_rgba(reader, false, width * 4, image.data_ptr<uint8_t>(), name);
  return image;
}

LabelPicture decode_png_labels(std::string_view bytes, const std::filesystem::path& name) {
  constexpr int kLargestLabel = 4095;
  PngReader reader(bytes);
  if (!read_header(reader)) throw_png_error(reader, name);
  if (png_get_bit_depth(reader.png, reader.info) < 16) return {decode_png(bytes, name)};
  const int64_t width = png_get_image_width(reader.png, reader.info);
  const int64_t height = png_get_image_height(reader.png, reader.info);
  check_image_size(width, height, name);
  // Each value is two bytes, the higher one first.
  const at::Tensor wide = at::empty({height, width, 4, 2}, at::kByte);
  read_rgba(reader, true, width * 8, wide.data_ptr<uint8_t>(), name);
  const at::Tensor high = wide.select(3, 0);
  const int highest = high.narrow(2, 0, 3).max().item<uint8_t>();
  if (highest > kLargestLabel / 256) return {decode_png(bytes, name)};
  at::Tensor image = wide.select(3, 1).masked_fill(high.ne(0), 255);
  image.select(2, 3).copy_(high.select(2, 3));
  return {image, /*exact=*/true, /*labels=*/highest > 0};
}

bool png_has_alpha(std::string_view bytes, const std::filesystem::path& name) {
  PngReader reader(bytes);
  if (!read_header(reader)) throw_png_error(reader, name);
  return (png_get_color_type(reader.png, reader.info) & PNG_COLOR_MASK_ALPHA) != 0 ||
         png_get_valid(reader.png, reader.info, PNG_INFO_tRNS) != 0;
}

std::string encode_png(const at::Tensor& image) {
  const at::Tensor pixels = check_encodable(image, "134");
  png_image header{};
  header.version = PNG_IMAGE_VERSION;
  header.width = static_cast<png_uint_32>(pixels.size(1));
  header.height = static_cast<png_uint_32>(pixels.size(0));
  constexpr png_uint_32 kFormats[] = {PNG_FORMAT_GRAY, 0, PNG_FORMAT_RGB, PNG_FORMAT_RGBA};
  header.format = kFormats[pixels.size(2) - 1];
  png_alloc_size_t size = PNG_IMAGE_PNG_SIZE_MAX(header);
  std::string bytes(size, '\0');
  if (png_image_write_to_memory(&header, bytes.data(), &size, 0, pixels.data_ptr<uint8_t>(), 0,
                                nullptr) == 0) {
    throw ResourceError(std::string("cannot encode a PNG image: ") + header.message);
  }
  bytes.resize(size);
  return bytes;
}

}  // namespace tt3d::image
