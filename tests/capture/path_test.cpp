#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "capture/synthetic_capture.h"
#include "support/error_of.h"
#include "support/exif.h"
#include "support/temporary_folder.h"
#include "tt3d/capture.h"
#include "tt3d/image.h"

// Captures that were written on other systems: backslashes, byte order marks, line ends, names in
// upper case; and the EXIF orientation.

namespace tt3d::capture {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using testing::error_of;

constexpr const char* kByteOrderMark = "\xEF\xBB\xBF";

class Paths : public ::testing::Test {
 protected:
  void SetUp() override {
    testing::write_nerfstudio(folder_.path(), testing::fixture_cameras(9));
    expected_ = testing::load(folder_.path());
  }
  void set_paths(const std::function<std::string(const std::string&)>& change) {
    testing::edit_json(folder_ / "transforms.json", [&](json& root) {
      for (json& frame : root["frames"]) {
        frame["file_path"] = change(frame["file_path"].get<std::string>());
      }
    });
  }
  void expect_same(const std::string& what) {
    const Capture capture = testing::load(folder_.path());
    ASSERT_EQ(capture.train.size(), expected_.train.size()) << what;
    for (size_t i = 0; i < capture.train.size(); ++i) {
      EXPECT_TRUE(at::equal(capture.train[i].rgba, expected_.train[i].rgba)) << what;
    }
  }

  testing::TemporaryFolder folder_;
  Capture expected_;
};

std::string with_backslashes(std::string path) {
  std::replace(path.begin(), path.end(), '/', '\\');
  return path;
}

TEST_F(Paths, Backslashes) {
  set_paths(with_backslashes);
  expect_same("images\\view_00.png");
  set_paths([](const std::string& path) { return ".\\" + path; });
  expect_same(".\\images\\view_00.png");
  set_paths([](const std::string&) { return "..\\..\\secret.png"; });
  EXPECT_NE(error_of([&] { (void)testing::load(folder_.path()); }).find("leads out"),
            std::string::npos);
  set_paths([](const std::string&) { return "C:\\photos\\a.png"; });
  EXPECT_NE(error_of([&] { (void)testing::load(folder_.path()); }).find("leads out"),
            std::string::npos);
}

TEST_F(Paths, AbsolutePathsInsideTheFolder) {
  set_paths([&](const std::string& path) { return (folder_ / path).string(); });
  expect_same("absolute");
}

TEST_F(Paths, NamesInUpperCase) {
  for (int i = 0; i < 9; ++i) {
    const std::string name = "images/view_0" + std::to_string(i);
    fs::rename(folder_ / (name + ".png"), folder_ / (name + ".PNG"));
  }
  expect_same("file_path in lower case, file in upper case");
  set_paths([](const std::string& path) { return path.substr(0, path.size() - 4); });
  expect_same("without extension");
}

TEST_F(Paths, ByteOrderMarkInJson) {
  const fs::path file = folder_ / "transforms.json";
  write_file_atomic(file, kByteOrderMark + read_file(file));
  expect_same("byte order mark");
  write_file_atomic(file, std::string("\xFF\xFE{\0}\0", 6));
  EXPECT_NE(error_of([&] { (void)testing::load(folder_.path()); }).find("is UTF-16 text"),
            std::string::npos);
}

TEST_F(Paths, ColmapTextFromWindows) {
  fs::remove(folder_ / "transforms.json");
  testing::write_colmap_text(folder_.path(), testing::fixture_cameras(9));
  for (const char* name : {"cameras.txt", "images.txt", "points3D.txt"}) {
    const fs::path path = folder_ / (std::string("sparse/0/") + name);
    std::string text = kByteOrderMark;
    for (const char c : read_file(path)) text += c == '\n' ? "\r\n" : std::string(1, c);
    write_file_atomic(path, text);
  }
  expect_same("byte order mark and CRLF");
  const fs::path images = folder_ / "sparse/0/images.txt";
  std::string text = read_file(images);
  for (size_t at = text.find("view_"); at != text.npos; at = text.find("view_", at + 9)) {
    text.insert(at, ".\\");
  }
  write_file_atomic(images, text);
  expect_same("backslashes");
}

TEST_F(Paths, PhotographsStayAsStored) {
  const fs::path path = folder_ / "images/view_03.png";
  const at::Tensor rgb = image::read_image(path).narrow(2, 0, 3).contiguous();
  write_file_atomic(folder_ / "m.png",
                    image::encode_png(image::read_image(path).narrow(2, 3, 1).contiguous()));
  testing::edit_json(folder_ / "transforms.json",
                     [](json& root) { root["frames"][3]["mask_path"] = "m.png"; });
  const auto pixels = [&](int orientation) {
    write_file_atomic(path, testing::jpeg_with_exif(image::encode_jpeg(rgb),
                                                    testing::exif_data(orientation, true)));
    return testing::load(folder_.path()).train[2].rgba;
  };
  EXPECT_TRUE(at::equal(pixels(6), pixels(1)));
}

}  // namespace
}  // namespace tt3d::capture
