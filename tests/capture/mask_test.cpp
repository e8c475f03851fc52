#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include "capture/mask.h"
#include "capture/synthetic_capture.h"
#include "support/error_of.h"
#include "support/keep_notes.h"
#include "support/make_png.h"
#include "support/temporary_folder.h"
#include "tt3d/capture.h"
#include "tt3d/image.h"

// Masks as tools and people write them: the reader of one file, and which file belongs to which
// picture.

namespace tt3d::capture {
namespace {

namespace fs = std::filesystem;
using testing::error_of;
using testing::make_png;

/// [16,16] bool: the object of the test masks, a block off the centre.
at::Tensor block() {
  at::Tensor object = at::zeros({16, 16}, at::kBool);
  object.narrow(0, 2, 9).narrow(1, 4, 7).fill_(true);
  return object;
}

/// [16,16,3] picture with one colour in the block and another around it.
at::Tensor two_colours(const std::vector<int>& object, const std::vector<int>& around) {
  const auto colour = [](const std::vector<int>& c) {
    return at::tensor(c).to(at::kByte).view({1, 1, 3}).expand({16, 16, 3});
  };
  return at::where(block().unsqueeze(2), colour(object), colour(around)).contiguous();
}

at::Tensor read(const std::string& bytes) {
  const testing::TemporaryFolder folder;
  write_file_atomic(folder / "m.png", bytes);
  return read_mask(folder / "m.png");
}

void expect_block(const std::string& bytes, const std::string& what) {
  EXPECT_TRUE(at::equal(read(bytes), block().to(at::kByte) * 255)) << what;
}

/// Rows of samples of the block: `object` where it is, else `around`.
std::vector<std::string> rows_of(const std::string& object, const std::string& around) {
  std::vector<std::string> rows;
  for (int y = 0; y < 16; ++y) {
    std::string row;
    for (int x = 0; x < 16; ++x) row += block()[y][x].item<bool>() ? object : around;
    rows.push_back(row);
  }
  return rows;
}

TEST(Mask, GreyWhiteAndSoft) {
  expect_block(image::encode_png(block().to(at::kByte).unsqueeze(2) * 255), "255");
  const at::Tensor soft = at::arange(256, at::kInt).to(at::kByte).view({16, 16});
  EXPECT_TRUE(at::equal(read(image::encode_png(soft.unsqueeze(2))), soft));
}

TEST(Mask, LabelsOfSmallValues) {
  for (const int value : {1, 2, 17, 38, 128, 254}) {
    const at::Tensor grey = block().to(at::kByte) * value;
    expect_block(image::encode_png(grey.unsqueeze(2)), std::to_string(value));
  }
  at::Tensor instances = block().to(at::kByte);
  instances.narrow(0, 2, 3).mul_(2);
  expect_block(image::encode_png(instances.unsqueeze(2)), "labels 1 and 2");
}

TEST(Mask, SixteenBit) {
  using namespace std::string_literals;
  for (const std::string& object : {"\xFF\xFF"s, "\x00\xFF"s, "\x00\x01"s, "\x01\x00"s}) {
    expect_block(make_png(PNG_COLOR_TYPE_GRAY, 16, 16, rows_of(object, "\0\0"s)), object);
  }
}

TEST(Mask, LabelsAbove255) {
  using namespace std::string_literals;
  std::vector<std::string> rows = rows_of("\x01\x2C"s, "\0\0"s);  // 300
  rows[4] = rows_of("\0\1"s, "\0\0"s)[4];
  expect_block(make_png(PNG_COLOR_TYPE_GRAY, 16, 16, rows), "labels 1 and 300");
}

TEST(Mask, OneBitAndPalette) {
  using namespace std::string_literals;
  std::vector<std::string> bits;
  for (int y = 0; y < 16; ++y) bits.push_back(y >= 2 && y < 11 ? "\x0F\xE0"s : "\0\0"s);
  expect_block(make_png(PNG_COLOR_TYPE_GRAY, 1, 16, bits), "one bit");
  const std::vector<std::string> indices = rows_of("\1"s, "\0"s);
  for (const png_color& colour : {png_color{128, 0, 0}, png_color{0, 0, 128}, png_color{0, 255, 0},
                                  png_color{1, 1, 1}, png_color{255, 255, 255}}) {
    expect_block(make_png(PNG_COLOR_TYPE_PALETTE, 8, 16, indices, "", {{0, 0, 0}, colour}),
                 "palette");
  }
  // A tool that sorts its palette: index 0 is white, the object.
  expect_block(make_png(PNG_COLOR_TYPE_PALETTE, 8, 16, rows_of("\0"s, "\1"s), "",
                        {{255, 255, 255}, {0, 0, 0}}),
               "palette with white first");
}

TEST(Mask, ColoursOnBlack) {
  for (const std::vector<int>& colour :
       std::vector<std::vector<int>>{{128, 0, 0}, {0, 0, 255}, {0, 64, 0}, {255, 255, 0}}) {
    expect_block(image::encode_png(two_colours(colour, {0, 0, 0})), "colour");
  }
  at::Tensor instances = two_colours({0, 128, 0}, {0, 0, 0});
  instances.narrow(0, 4, 2).narrow(1, 5, 2).copy_(at::tensor({128, 0, 128}).to(at::kByte));
  expect_block(image::encode_png(instances), "two instances");
}

TEST(Mask, AlphaChannel) {
  const at::Tensor alpha = block().to(at::kByte).unsqueeze(2) * 255;
  for (const at::Tensor& colour :
       {two_colours({255, 255, 255}, {255, 255, 255}), two_colours({0, 0, 0}, {0, 0, 0}),
        two_colours({10, 200, 30}, {0, 0, 0})}) {
    expect_block(image::encode_png(at::cat({colour, alpha}, 2)), "alpha");
  }
  const at::Tensor opaque = at::full({16, 16, 1}, 255, at::kByte);
  expect_block(image::encode_png(at::cat({two_colours({255, 255, 255}, {0, 0, 0}), opaque}, 2)),
               "opaque");
}

TEST(Mask, JpegIsThresholded) {
  const at::Tensor small = two_colours({255, 255, 255}, {0, 0, 0});
  const at::Tensor large = small.repeat_interleave(8, 0).repeat_interleave(8, 1).contiguous();
  const at::Tensor expected = large.select(2, 0);
  EXPECT_TRUE(at::equal(read(image::encode_jpeg(large, 60)), expected));
  const at::Tensor red = (large * at::tensor({1, 0, 0}).to(at::kByte)).contiguous();
  const at::Tensor wrong = read(image::encode_jpeg(red, 85)).ne(expected);
  EXPECT_LT(wrong.sum().item<int64_t>(), 0.02 * static_cast<double>(expected.numel()));
}

TEST(Mask, WhatIsNoMaskIsRefused) {
  const auto error = [](const std::string& bytes) { return error_of([&] { (void)read(bytes); }); };
  EXPECT_NE(error(image::encode_png(two_colours({253, 231, 37}, {68, 1, 84})))
                .find("coloured mask without black"),
            std::string::npos);
  at::Tensor labels = block().to(at::kByte) + 1;
  EXPECT_NE(error(image::encode_png(labels.unsqueeze(2))).find("no pixel has label 0"),
            std::string::npos);
  labels = block().to(at::kByte);
  labels.narrow(0, 12, 1).fill_(255);
  EXPECT_NE(error(image::encode_png(labels.unsqueeze(2))).find("also the value 255"),
            std::string::npos);
  const at::Tensor ramp = at::arange(64, at::kInt) * 4;
  const at::Tensor photograph =
      at::stack({ramp.view({64, 1}).expand({64, 64}), ramp.view({1, 64}).expand({64, 64}),
                 (ramp.view({64, 1}) + ramp.view({1, 64})).remainder(256)},
                2)
          .to(at::kByte)
          .contiguous();
  EXPECT_NE(error(image::encode_png(photograph)).find("photograph, not a mask"), std::string::npos);
}

/// A capture whose photographs have no alpha; each test writes the masks.
class MaskFilesOfACapture : public ::testing::Test {
 protected:
  void SetUp() override {
    testing::write_nerfstudio(folder_.path(), testing::fixture_cameras(kViews));
    expected_ = testing::load(folder_.path());
    for (int i = 0; i < kViews; ++i) {
      const at::Tensor rgba = image::read_image(picture(i));
      alpha_.push_back(rgba.narrow(2, 3, 1).contiguous());
      write_file_atomic(picture(i), image::encode_png(rgba.narrow(2, 0, 3)));
    }
  }
  [[nodiscard]] static std::string name(int i) { return "view_0" + std::to_string(i); }
  [[nodiscard]] fs::path picture(int i) const { return folder_ / ("images/" + name(i) + ".png"); }
  void write_masks(const std::string& before, const std::string& after, int count = kViews) {
    for (int i = 0; i < count; ++i) {
      write_file_atomic(folder_ / (before + name(i) + after), image::encode_png(alpha_[i]));
    }
  }
  void expect_masks(const std::string& what) {
    const Capture capture = testing::load(folder_.path());
    EXPECT_TRUE(capture.has_masks) << what;
    for (size_t i = 0; i < capture.train.size(); ++i) {
      EXPECT_TRUE(at::equal(capture.train[i].rgba, expected_.train[i].rgba)) << what;
    }
  }
  [[nodiscard]] testing::KeepNotes notes() const {
    testing::KeepNotes kept;
    CaptureOptions options;
    options.path = folder_.path();
    (void)error_of([&] { (void)load_capture(options, kept); });
    return kept;
  }
  [[nodiscard]] std::string load_error() const {
    return error_of([&] { (void)testing::load(folder_.path()); });
  }

  static constexpr int kViews = 9;
  testing::TemporaryFolder folder_;
  Capture expected_;
  std::vector<at::Tensor> alpha_;
};

TEST_F(MaskFilesOfACapture, EveryUsualNameIsFoundInBothForms) {
  const std::pair<const char*, const char*> names[] = {
      {"masks/", ".png"},        {"masks/", ".png.png"},   {"masks/", ".PNG"},
      {"masks/images/", ".png"}, {"mask/", ".png"},        {"masks/", "_mask.png"},
      {"images/", "_mask.png"},  {"images/", "_mask.PNG"}, {"images/", ".png.mask.png"}};
  testing::TemporaryFolder model;
  testing::write_colmap_text(model.path(), testing::fixture_cameras(kViews));
  for (const bool colmap : {false, true}) {
    if (colmap) {
      fs::remove(folder_ / "transforms.json");
      fs::copy(model / "sparse", folder_ / "sparse", fs::copy_options::recursive);
    }
    for (const auto& [before, after] : names) {
      write_masks(before, after);
      expect_masks(std::string(before) + "NAME" + after);
      for (int i = 0; i < kViews; ++i) fs::remove(folder_ / (before + name(i) + after));
      fs::remove_all(folder_ / "masks");
      fs::remove_all(folder_ / "mask");
    }
  }
}

TEST_F(MaskFilesOfACapture, HiddenFilesAreSkipped) {
  write_masks("masks/", ".png");
  write_file_atomic(folder_ / "masks/._view_00.png", "Mac");
  write_file_atomic(folder_ / "masks/.DS_Store", "Mac");
  expect_masks("hidden files");
}

TEST_F(MaskFilesOfACapture, AFolderThatMatchesNothingIsAnError) {
  fs::create_directory(folder_ / "masks");
  EXPECT_NE(load_error().find("no file in it is the mask of a picture"), std::string::npos);
  write_masks("masks/other_", ".png");
  EXPECT_NE(load_error().find("masks: no file in it is the mask of a picture"), std::string::npos)
      << load_error();
  EXPECT_NE(load_error().find("expected masks/view_01.png.png or masks/view_01.png"),
            std::string::npos);
}

TEST_F(MaskFilesOfACapture, TheFirstPictureWithoutAMaskIsNamed) {
  write_masks("masks/", ".png", kViews - 2);
  EXPECT_NE(load_error().find("view_07.png: has neither alpha nor a mask file"), std::string::npos)
      << load_error();
}

TEST_F(MaskFilesOfACapture, ContradictionsAreErrors) {
  write_masks("masks/", ".png");
  write_file_atomic(folder_ / "masks/view_03.jpg",
                    image::encode_jpeg(alpha_[3].expand({-1, -1, 3}).contiguous()));
  EXPECT_NE(load_error().find("may be the mask of images/view_03.png, but so may"),
            std::string::npos)
      << load_error();
}

TEST_F(MaskFilesOfACapture, InvertedMasksAreNoted) {
  write_masks("masks/", ".png");
  EXPECT_FALSE(notes().contain("invert the masks"));
  for (at::Tensor& alpha : alpha_) alpha = 255 - alpha;
  write_masks("masks/", ".png");
  EXPECT_TRUE(notes().contain("white (or alpha) must be the object"));
  for (at::Tensor& alpha : alpha_) alpha = at::full_like(alpha, 255);
  write_masks("masks/", ".png");
  EXPECT_TRUE(notes().contain("mark every pixel of every view as object"));
}

}  // namespace
}  // namespace tt3d::capture
