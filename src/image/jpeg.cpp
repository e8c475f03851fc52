#include <ATen/ATen.h>

#include <csetjmp>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include <jerror.h>
#include <jpeglib.h>

#include "codec.h"
#include "tt3d/core.h"

// libjpeg reports errors through error_exit, which must not return and so calls longjmp. Functions
// that call setjmp hold no object with a destructor, as with libpng.

namespace tt3d::image {
namespace {

struct JpegErrors {
  jpeg_error_mgr manager{};
  std::jmp_buf jump{};
  char message[JMSG_LENGTH_MAX] = "";
};

extern "C" [[noreturn]] void jpeg_on_error(j_common_ptr common) {
  auto* errors = reinterpret_cast<JpegErrors*>(common->err);
  common->err->format_message(common, errors->message);
  std::longjmp(errors->jump, 1);
}

/// libjpeg only warns about damaged data and fills it with grey pixels; this refuses such files.
/// Stray bytes before a marker are harmless, and common in camera files.
extern "C" void jpeg_on_message(j_common_ptr common, int level) {
  if (level < 0 &&
      (common->err->msg_code == JWRN_JPEG_EOF || common->err->msg_code == JWRN_HIT_MARKER ||
       common->err->msg_code == JWRN_HUFF_BAD_CODE || common->err->msg_code == JWRN_MUST_RESYNC)) {
    jpeg_on_error(common);
  }
}

void set_handlers(JpegErrors& errors) {
  jpeg_std_error(&errors.manager);
  errors.manager.error_exit = jpeg_on_error;
  errors.manager.emit_message = jpeg_on_message;
}

struct JpegReader {
  jpeg_decompress_struct info{};
  JpegErrors errors;
  JpegReader() {
    set_handlers(errors);
    info.err = &errors.manager;
  }
  ~JpegReader() { jpeg_destroy_decompress(&info); }
  JpegReader(const JpegReader&) = delete;
  JpegReader& operator=(const JpegReader&) = delete;
};

bool read_header(JpegReader& reader, std::string_view bytes) {
  if (setjmp(reader.errors.jump) != 0) return false;
  jpeg_create_decompress(&reader.info);
  jpeg_mem_src(&reader.info, reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size());
  jpeg_read_header(&reader.info, TRUE);
  return true;
}

/// Decodes into RGBA rows of `width` pixels with alpha 255.
bool read_pixels(JpegReader& reader, uint8_t* rgba) {
  if (setjmp(reader.errors.jump) != 0) return false;
  reader.info.out_color_space = JCS_EXT_RGBA;
  jpeg_start_decompress(&reader.info);
  while (reader.info.output_scanline < reader.info.output_height) {
    JSAMPROW row = rgba + size_t{reader.info.output_scanline} * reader.info.output_width * 4;
    jpeg_read_scanlines(&reader.info, &row, 1);
  }
  jpeg_finish_decompress(&reader.info);
  return true;
}

[[noreturn]] void throw_jpeg_error(const JpegReader& reader, const std::filesystem::path& name) {
  throw InputError(name, std::string("cannot decode the JPEG image: ") + reader.errors.message +
                             "; replace the file");
}

struct JpegWriter {
  jpeg_compress_struct info{};
  JpegErrors errors;
  unsigned char* buffer = nullptr;
  unsigned long size = 0;
  JpegWriter() {
    set_handlers(errors);
    info.err = &errors.manager;
  }
  ~JpegWriter() {
    jpeg_destroy_compress(&info);
    std::free(buffer);
  }
  JpegWriter(const JpegWriter&) = delete;
  JpegWriter& operator=(const JpegWriter&) = delete;
};

bool write_pixels(JpegWriter& writer, const uint8_t* rgb, int width, int height, int quality) {
  if (setjmp(writer.errors.jump) != 0) return false;
  jpeg_create_compress(&writer.info);
  jpeg_mem_dest(&writer.info, &writer.buffer, &writer.size);
  writer.info.image_width = static_cast<JDIMENSION>(width);
  writer.info.image_height = static_cast<JDIMENSION>(height);
  writer.info.input_components = 3;
  writer.info.in_color_space = JCS_RGB;
  jpeg_set_defaults(&writer.info);
  jpeg_set_quality(&writer.info, quality, TRUE);
  jpeg_start_compress(&writer.info, TRUE);
  while (writer.info.next_scanline < writer.info.image_height) {
    auto* row = const_cast<uint8_t*>(rgb) + size_t{writer.info.next_scanline} * width * 3;
    jpeg_write_scanlines(&writer.info, &row, 1);
  }
  jpeg_finish_compress(&writer.info);
  return true;
}

}  // namespace

bool is_jpeg(std::string_view bytes) { return bytes.starts_with("\xFF\xD8\xFF"); }

at::Tensor decode_jpeg(std::string_view bytes, const std::filesystem::path& name) {
  JpegReader reader;
  if (!read_header(reader, bytes)) throw_jpeg_error(reader, name);
  check_image_size(reader.info.image_width, reader.info.image_height, name);
  if (reader.info.num_components == 4) {
    throw InputError(name, "is a CMYK JPEG; convert it to RGB");
  }
  at::Tensor image = at::empty(
      {int64_t{reader.info.image_height}, int64_t{reader.info.image_width}, 4}, at::kByte);
  if (!read_pixels(reader, image.data_ptr<uint8_t>())) throw_jpeg_error(reader, name);
  return image;
}

std::string encode_jpeg(const at::Tensor& image, int quality) {
  const at::Tensor pixels = check_encodable(image, "3");
  if (quality < 1 || quality > 100) throw InputError("JPEG quality: expected 1 to 100");
  JpegWriter writer;
  if (!write_pixels(writer, pixels.data_ptr<uint8_t>(), static_cast<int>(pixels.size(1)),
                    static_cast<int>(pixels.size(0)), quality)) {
    throw ResourceError(std::string("cannot encode a JPEG image: ") + writer.errors.message);
  }
  return {reinterpret_cast<const char*>(writer.buffer), writer.size};
}

}  // namespace tt3d::image
