#include "tt3d/pictures.h"

#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include "support/exif.h"
#include "support/make_png.h"
#include "support/temporary_folder.h"
#include "tt3d/core.h"
#include "tt3d/image.h"

namespace tt3d::image {
namespace {

using at::Tensor;

/// [24,40,3]: a picture in which each quarter has another colour.
Tensor quarters() {
  Tensor picture = at::zeros({24, 40, 3}, at::kByte);
  picture.narrow(0, 0, 12).select(2, 0).fill_(220);
  picture.narrow(1, 0, 20).select(2, 1).fill_(200);
  return picture;
}

/// The pixels that a camera with this orientation stores of an upright picture: the inverse of what
/// a viewer does, by the table of the EXIF standard.
Tensor stored(const Tensor& upright, int orientation) {
  switch (orientation) {
    case 2:
      return upright.flip({1});
    case 3:
      return upright.flip({0, 1});
    case 4:
      return upright.flip({0});
    case 5:
      return upright.transpose(0, 1);
    case 6:
      return upright.rot90(1, {0, 1});
    case 7:
      return upright.flip({0, 1}).transpose(0, 1);
    case 8:
      return upright.rot90(-1, {0, 1});
    default:
      return upright;
  }
}

TEST(Upright, AllOrientationsOfPngAndJpeg) {
  const testing::TemporaryFolder folder;
  const std::filesystem::path path = folder / "a.png";
  const Tensor upright = quarters();
  for (int orientation = 1; orientation <= 8; ++orientation) {
    const Tensor pixels = stored(upright, orientation).contiguous();
    for (const bool little : {false, true}) {
      const std::string exif = testing::exif_data(orientation, little);
      write_file_atomic(path, testing::png_with_exif(encode_png(pixels), exif));
      EXPECT_TRUE(at::equal(read_upright_image(path).narrow(2, 0, 3), upright)) << orientation;
      write_file_atomic(path, testing::jpeg_with_exif(encode_jpeg(pixels, 95), exif));
      const Tensor shown = read_upright_image(path).narrow(2, 0, 3);
      ASSERT_EQ(shown.sizes(), upright.sizes()) << orientation;
      EXPECT_LT((shown.to(at::kFloat) - upright.to(at::kFloat)).abs().mean().item<double>(), 6)
          << orientation;
      EXPECT_EQ(read_image(path).size(0), pixels.size(0));
    }
  }
}

TEST(Upright, DamagedExifIsAbsent) {
  const std::string jpeg = encode_jpeg(quarters(), 90), png = encode_png(quarters());
  EXPECT_EQ(exif_orientation(jpeg), 1);
  EXPECT_EQ(exif_orientation(png), 1);
  EXPECT_EQ(exif_orientation(""), 1);
  EXPECT_EQ(exif_orientation(testing::jpeg_with_exif(jpeg, testing::exif_data(6, true))), 6);
  for (const int orientation : {0, 9, 65535}) {
    const std::string exif = testing::exif_data(orientation, true);
    EXPECT_EQ(exif_orientation(testing::jpeg_with_exif(jpeg, exif)), 1) << orientation;
  }
  const std::string exif = testing::exif_data(6, false);
  for (size_t size = 0; size < 20; ++size) {
    EXPECT_EQ(exif_orientation(testing::jpeg_with_exif(jpeg, exif.substr(0, size))), 1) << size;
    EXPECT_EQ(exif_orientation(testing::png_with_exif(png, exif.substr(0, size))), 1) << size;
  }
}

TEST(LabelPicture, SmallValuesOfSixteenBitsAreKept) {
  using namespace std::string_literals;
  const testing::TemporaryFolder folder;
  const std::filesystem::path path = folder / "a.png";
  const auto first = [&](const std::string& row) {
    write_file_atomic(path, testing::make_png(PNG_COLOR_TYPE_GRAY, 16, 2, {row}));
    return read_label_picture(path).rgba[0][0][0].item<int>();
  };
  EXPECT_EQ(first("\0\1\0\0"s), 1);
  EXPECT_EQ(first("\0\xFF\0\0"s), 255);
  EXPECT_EQ(first("\xFF\xFF\0\0"s), 255);
  EXPECT_EQ(first("\0\1\x80\0"s), 0);
  EXPECT_TRUE(read_label_picture(path).exact);
  write_file_atomic(path, encode_jpeg(quarters()));
  EXPECT_FALSE(read_label_picture(path).exact);
}

}  // namespace
}  // namespace tt3d::image
