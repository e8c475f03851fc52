#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include <set>
#include <string>

#include "support/exif.h"
#include "support/temporary_folder.h"
#include "tt3d/core.h"
#include "tt3d/image.h"
#include "tt3d/scene.h"

namespace tt3d::scene {
namespace {

using at::Tensor;

TEST(Backgrounds, ColoursFoldersAndMistakes) {
  Random random(1, "test", 0);
  const Tensor red = Backgrounds("#ff0000").draw(2, 2, random);
  EXPECT_EQ(red[1][1][0].item<float>(), 1);
  EXPECT_EQ(red[1][1][1].item<float>(), 0);
  for (const char* bad : {"#ff00", "blue", "/nonexistent", "#gg0000"}) {
    EXPECT_THROW(Backgrounds{bad}, InputError) << bad;
  }
  testing::TemporaryFolder folder;
  EXPECT_THROW(Backgrounds{folder.path().string()}, InputError);
  write_file_atomic(folder / "a.png", image::encode_png(at::full({6, 9, 3}, 51, at::kByte)));
  const Tensor photo = Backgrounds(folder.path().string()).draw(8, 12, random);
  EXPECT_EQ(photo.sizes(), (at::IntArrayRef{8, 12, 3}));
  EXPECT_NEAR(photo[4][4][1].item<double>(), 0.2, 1e-4);
}

TEST(Backgrounds, FoldersAsUsersHaveThem) {
  testing::TemporaryFolder folder;
  const std::string grey = image::encode_png(at::full({6, 9, 3}, 51, at::kByte));
  write_file_atomic(folder / "._IMG_0000.JPG", "Mac");
  write_file_atomic(folder / ".DS_Store", "Mac");
  write_file_atomic(folder / "notes.txt", "text");
  EXPECT_THROW(Backgrounds{folder.path().string()}, InputError);
  for (const char* name : {"IMG_0001.JPG", "IMG_0002.JPEG", "X.PNG"}) {
    write_file_atomic(folder / name, grey);
  }
  const Backgrounds backgrounds(folder.path().string());
  for (uint64_t i = 0; i < 20; ++i) {
    Random random(7, "test", i);
    EXPECT_NEAR(backgrounds.draw(4, 4, random)[1][1][0].item<double>(), 0.2, 1e-4);
  }
}

TEST(Backgrounds, PhotographsAreUpright) {
  testing::TemporaryFolder folder;
  // Stored upside down: the lower half is white, so the upright picture is white above.
  at::Tensor stored = at::zeros({8, 8, 3}, at::kByte);
  stored.narrow(0, 4, 4).fill_(255);
  write_file_atomic(folder / "a.png",
                    testing::png_with_exif(image::encode_png(stored), testing::exif_data(3, true)));
  Random random(1, "test", 0);
  const Tensor drawn = Backgrounds(folder.path().string()).draw(8, 8, random);
  EXPECT_NEAR(drawn[0][4][0].item<double>(), 1, 1e-4);
  EXPECT_NEAR(drawn[7][4][0].item<double>(), 0, 1e-4);
}

TEST(Backgrounds, PhotographsAreDrawnByTheStream) {
  testing::TemporaryFolder folder;
  for (int i = 0; i < 4; ++i) {
    write_file_atomic(folder / (std::to_string(i) + ".png"),
                      image::encode_png(at::full({4, 4, 3}, 51 * i, at::kByte)));
  }
  const Backgrounds backgrounds(folder.path().string());
  const auto level = [&](uint64_t index) {
    Random random(7, "test", index);
    return backgrounds.draw(2, 2, random)[0][0][0].item<float>();
  };
  std::set<float> seen;
  for (uint64_t i = 0; i < 40; ++i) {
    seen.insert(level(i));
    EXPECT_EQ(level(i), level(i));
  }
  EXPECT_EQ(seen.size(), 4U);
}

}  // namespace
}  // namespace tt3d::scene
