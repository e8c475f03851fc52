#include <ATen/ATen.h>
#include <gtest/gtest.h>
#include <webp/encode.h>

#include "support/make_png.h"
#include "support/temporary_folder.h"
#include "tt3d/core.h"
#include "tt3d/image.h"

namespace tt3d::image {
namespace {

at::Tensor gradient(int64_t height, int64_t width, int64_t channels) {
  const at::Tensor rows = at::arange(height, at::kInt).view({height, 1, 1}) * 7;
  const at::Tensor columns = at::arange(width, at::kInt).view({1, width, 1}) * 3;
  const at::Tensor planes = at::arange(channels, at::kInt).view({1, 1, channels}) * 50;
  return (rows + columns + planes).remainder(256).to(at::kByte);
}

using testing::make_png;

std::vector<int> pixel(const at::Tensor& image, int64_t row, int64_t column) {
  std::vector<int> values;
  for (int64_t c = 0; c < 4; ++c) values.push_back(image[row][column][c].item<uint8_t>());
  return values;
}

std::string decode_error(const std::string& bytes) {
  try {
    (void)decode_image(bytes, "folder/x.png");
  } catch (const InputError& error) {
    EXPECT_NE(std::string(error.what()).find("folder/x.png"), std::string::npos);
    return error.what();
  }
  return "";
}

TEST(Image, PngRoundTripOfOneThreeAndFourChannels) {
  for (const int64_t channels : {1, 3, 4}) {
    const at::Tensor image = gradient(9, 13, channels);
    const at::Tensor back = decode_image(encode_png(image), "x");
    ASSERT_EQ(back.sizes(), at::IntArrayRef({9, 13, 4}));
    for (int64_t c = 0; c < 4; ++c) {
      const at::Tensor expected = c == 3 && channels < 4 ? at::full({9, 13}, 255, at::kByte)
                                                         : image.select(2, channels == 1 ? 0 : c);
      EXPECT_TRUE(at::equal(back.select(2, c), expected)) << channels << " " << c;
    }
  }
}

TEST(Image, SixteenBitRoundsToEight) {
  const std::string row = {'\x80', '\x00', '\xFF', '\xFF', '\x00', '\x00'};
  const at::Tensor image = decode_image(make_png(PNG_COLOR_TYPE_RGB, 16, 1, {row}), "x");
  EXPECT_EQ(pixel(image, 0, 0), (std::vector<int>{128, 255, 0, 255}));
}

TEST(Image, PaletteWithTransparency) {
  const std::string bytes = make_png(PNG_COLOR_TYPE_PALETTE, 8, 2, {std::string("\x00\x01", 2)},
                                     std::string("\x00\x80", 2));
  const at::Tensor image = decode_image(bytes, "x");
  EXPECT_EQ(pixel(image, 0, 0), (std::vector<int>{10, 20, 30, 0}));
  EXPECT_EQ(pixel(image, 0, 1), (std::vector<int>{200, 150, 100, 128}));
}

TEST(Image, OneBitGrey) {
  const at::Tensor image = decode_image(make_png(PNG_COLOR_TYPE_GRAY, 1, 8, {"\xA0"}), "x");
  EXPECT_EQ(pixel(image, 0, 0), (std::vector<int>{255, 255, 255, 255}));
  EXPECT_EQ(pixel(image, 0, 1), (std::vector<int>{0, 0, 0, 255}));
}

TEST(Image, AlphaIsFoundByContent) {
  testing::TemporaryFolder folder;
  write_file_atomic(folder / "a.jpg", encode_png(gradient(2, 2, 4)));  // the content is a PNG
  write_file_atomic(folder / "b.png", encode_png(gradient(2, 2, 3)));
  write_file_atomic(folder / "c.png", make_png(PNG_COLOR_TYPE_PALETTE, 8, 1,
                                               {std::string("\x00", 1)}, std::string("\x00", 1)));
  write_file_atomic(folder / "d.png", encode_jpeg(gradient(2, 2, 3)));
  EXPECT_TRUE(image_has_alpha(folder / "a.jpg"));
  EXPECT_FALSE(image_has_alpha(folder / "b.png"));
  EXPECT_TRUE(image_has_alpha(folder / "c.png"));
  EXPECT_FALSE(image_has_alpha(folder / "d.png"));
  EXPECT_EQ(read_image(folder / "d.png").size(2), 4);
}

TEST(Image, JpegRoundTripIsClose) {
  const at::Tensor image =
      at::arange(64, at::kInt).mul(3).view({1, 64, 1}).expand({48, 64, 3}).to(at::kByte);
  const at::Tensor back = decode_image(encode_jpeg(image, 95), "x");
  const at::Tensor difference = (back.narrow(2, 0, 3).to(at::kFloat) - image.to(at::kFloat)).abs();
  EXPECT_LT(difference.max().item<float>(), 8);
  EXPECT_EQ(back.select(2, 3).min().item<uint8_t>(), 255);
}

TEST(Image, EveryTruncationIsAnError) {
  for (const std::string& bytes :
       {encode_png(gradient(40, 50, 4)), encode_jpeg(gradient(40, 50, 3))}) {
    for (size_t size = 0; size + 2 < bytes.size(); size += 1 + bytes.size() / 60) {
      EXPECT_NE(decode_error(bytes.substr(0, size)), "") << size << " of " << bytes.size();
    }
  }
}

TEST(Image, CorruptAndForeignDataAreErrors) {
  std::string bytes = encode_png(gradient(40, 50, 4));
  bytes[bytes.size() / 2] = static_cast<char>(bytes[bytes.size() / 2] ^ 0x55);
  EXPECT_NE(decode_error(bytes).find("cannot decode"), std::string::npos);
  EXPECT_NE(decode_error("").find("empty"), std::string::npos);
  EXPECT_NE(decode_error("GIF89a").find("neither PNG nor JPEG"), std::string::npos);
}

/// Where a JPEG's marker of this type starts.
size_t marker(const std::string& bytes, char type) {
  return bytes.find(std::string("\xFF") + type);
}

TEST(Image, StrayBytesBeforeAMarkerAreReadAndDamageAfterThemIsRefused) {
  const std::string good = encode_jpeg(gradient(40, 50, 3));
  std::string stray = good;
  stray.insert(marker(good, '\xDA'), 4, '\0');
  EXPECT_TRUE(at::equal(decode_image(stray, "x"), decode_image(good, "x")));
  EXPECT_NE(decode_error(stray.substr(0, stray.size() * 2 / 3)).find("cannot decode"),
            std::string::npos);
}

TEST(Image, UnusualJpegSamplingIsRead) {
  std::string bytes = encode_jpeg(at::full({16, 8, 3}, 77, at::kByte));
  // The first component: 1x4 samples in place of 2x2. As many blocks, so the data still fits.
  bytes[marker(bytes, '\xC0') + 11] = '\x14';
  const at::Tensor image = decode_image(bytes, "x");
  ASSERT_EQ(image.sizes(), at::IntArrayRef({16, 8, 4}));
  EXPECT_TRUE(image.narrow(2, 0, 3).eq(77).all().item<bool>());
}

/// [H,W,4] uint8 as lossless WebP.
std::string make_webp(const at::Tensor& image) {
  uint8_t* data = nullptr;
  const auto width = static_cast<int>(image.size(1)), height = static_cast<int>(image.size(0));
  const size_t size =
      WebPEncodeLosslessRGBA(image.const_data_ptr<uint8_t>(), width, height, 4 * width, &data);
  std::string bytes(reinterpret_cast<const char*>(data), size);
  WebPFree(data);
  return bytes;
}

TEST(Image, WebpIsRead) {
  at::Tensor image = gradient(9, 13, 4);
  image.select(2, 3).clamp_(1);  // a transparent pixel has no colour in WebP
  const std::string bytes = make_webp(image);
  EXPECT_TRUE(at::equal(decode_image(bytes, "x.webp"), image));
  const testing::TemporaryFolder folder;
  write_file_atomic(folder / "alpha.webp", bytes);
  EXPECT_TRUE(image_has_alpha(folder / "alpha.webp"));
  image.select(2, 3).fill_(255);
  write_file_atomic(folder / "opaque.webp", make_webp(image));
  EXPECT_FALSE(image_has_alpha(folder / "opaque.webp"));
  for (size_t size = 12; size < bytes.size(); size += 5) {
    EXPECT_NE(decode_error(bytes.substr(0, size)).find("WebP"), std::string::npos) << size;
  }
}

TEST(Image, OtherFormatsAreNamed) {
  EXPECT_NE(decode_error("GIF89a").find("is a GIF file"), std::string::npos);
  EXPECT_NE(decode_error(std::string("II*\0", 4)).find("is a TIFF file"), std::string::npos);
  EXPECT_NE(decode_error("BM12").find("is a BMP file"), std::string::npos);
  EXPECT_NE(decode_error(std::string("\0\0\0\x18"
                                     "ftypheic ",
                                     13))
                .find("HEIC or AVIF"),
            std::string::npos);
}

TEST(Image, CmykJpegIsRefused) {
  // A header of 16x16 pixels with four components, and a scan of them.
  const std::string bytes(
      "\xFF\xD8\xFF\xC0\x00\x14\x08\x00\x10\x00\x10\x04\x01\x11\x00\x02\x11\x00\x03\x11\x00\x04\x11"
      "\x00"
      "\xFF\xDA\x00\x0E\x04\x01\x00\x02\x00\x03\x00\x04\x00\x00\x3F\x00",
      40);
  EXPECT_NE(decode_error(bytes).find("CMYK"), std::string::npos) << decode_error(bytes);
}

TEST(Image, GammaOfAPngIsIgnored) {
  // glTF requires this of textures; Pillow and PyTorch's tools ignore it too.
  std::string bytes = make_png(PNG_COLOR_TYPE_RGB, 8, 1, {"\x40\x80\xC0"});
  // gAMA 1.0 with its checksum, after the 33 bytes of signature and IHDR.
  bytes.insert(33, std::string("\0\0\0\4gAMA\0\1\x86\xA0\x31\xE8\x96\x5F", 16));
  EXPECT_EQ(pixel(decode_image(bytes, "x"), 0, 0), (std::vector<int>{0x40, 0x80, 0xC0, 255}));
}

TEST(Image, TooManyPixelsAreRefusedBeforeTheyAreAllocated) {
  std::string bytes = encode_png(gradient(2, 2, 3));
  // Width and height in the header; the header's checksum is corrected too.
  const uint8_t size[] = {0, 0, 0xFF, 0xFF, 0, 0, 0xFF, 0xFF};
  std::copy(std::begin(size), std::end(size), bytes.begin() + 16);
  uint32_t crc = 0xFFFFFFFFU;
  for (size_t i = 12; i < 29; ++i) {
    crc ^= static_cast<uint8_t>(bytes[i]);
    for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1) ^ ((crc & 1) != 0 ? 0xEDB88320U : 0);
  }
  for (int i = 0; i < 4; ++i) bytes[29 + i] = static_cast<char>(~crc >> (24 - 8 * i));
  EXPECT_NE(decode_error(bytes).find("over the limit"), std::string::npos);
}

TEST(Image, WhatCannotBeEncodedIsRefused) {
  EXPECT_THROW((void)encode_png(at::zeros({2, 2, 2}, at::kByte)), InputError);
  EXPECT_THROW((void)encode_png(at::zeros({2, 2, 3})), InputError);
  EXPECT_THROW((void)encode_png(at::zeros({0, 2, 3}, at::kByte)), InputError);
  EXPECT_THROW((void)encode_jpeg(gradient(2, 2, 4)), InputError);
  EXPECT_THROW((void)encode_jpeg(gradient(2, 2, 3), 0), InputError);
}

TEST(Image, ToUint8RoundsAndClamps) {
  const at::Tensor image = at::tensor({-1.0F, 0.0F, 0.4999F / 255, 0.5001F / 255, 1.0F, 2.0F});
  const at::Tensor expected = at::tensor({0, 0, 0, 1, 255, 255}).to(at::kByte);
  EXPECT_TRUE(at::equal(to_uint8(image), expected));
}

}  // namespace
}  // namespace tt3d::image
