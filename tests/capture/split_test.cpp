#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include <sstream>

#include "capture/synthetic_capture.h"
#include "support/error_of.h"
#include "support/keep_notes.h"
#include "support/temporary_folder.h"
#include "tt3d/capture.h"
#include "tt3d/image.h"

// Which views are trained on, which are test views, and which COLMAP model is read.

namespace tt3d::capture {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using testing::error_of;

Capture load(const fs::path& path, Progress& progress) {
  CaptureOptions options;
  options.path = path;
  return load_capture(options, progress);
}

/// The names of views without folder and "view_": "03.png".
std::vector<std::string> names(const std::vector<View>& views) {
  std::vector<std::string> out;
  for (const View& view : views) out.push_back(fs::path(view.name).filename().string().substr(5));
  return out;
}

using Names = std::vector<std::string>;

class Split : public ::testing::Test {
 protected:
  void SetUp() override { testing::write_nerfstudio(folder_.path(), testing::fixture_cameras(9)); }
  void edit(const std::function<void(json&)>& change) {
    testing::edit_json(folder_ / "transforms.json", change);
  }
  Capture load_here() { return load(folder_.path(), notes_); }
  [[nodiscard]] std::string load_error() {
    return error_of([&] { (void)load_here(); });
  }
  /// Paths of the views first..last.
  static json paths(int first, int last, const std::string& folder = "images/") {
    json list = json::array();
    for (int i = first; i <= last; ++i) {
      list.push_back(folder + "view_0" + std::to_string(i) + ".png");
    }
    return list;
  }

  testing::TemporaryFolder folder_;
  testing::KeepNotes notes_;
};

TEST_F(Split, ValidationViewsAreNotTrainedOn) {
  edit([](json& root) {
    root["train_filenames"] = paths(0, 5);
    root["val_filenames"] = paths(6, 8);
  });
  const Capture capture = load_here();
  EXPECT_EQ(capture.train.size(), 6U);
  EXPECT_EQ(names(capture.test), (Names{"06.png", "07.png", "08.png"}));
}

TEST_F(Split, TestViewsComeBeforeValidationViews) {
  edit([](json& root) {
    root["val_filenames"] = paths(6, 7);
    root["test_filenames"] = paths(7, 8);
  });
  const Capture capture = load_here();
  EXPECT_EQ(capture.train.size(), 6U);
  EXPECT_EQ(names(capture.test), (Names{"07.png", "08.png"}));
}

TEST_F(Split, OnlyTrainingViewsAreNamed) {
  edit([](json& root) { root["train_filenames"] = paths(2, 8); });
  const Capture capture = load_here();
  EXPECT_EQ(capture.train.size(), 7U);
  EXPECT_EQ(names(capture.test), (Names{"00.png", "01.png"}));
}

TEST_F(Split, ViewsInNoListAreLeftOutWithANote) {
  edit([](json& root) {
    root["train_filenames"] = paths(0, 5);
    root["test_filenames"] = paths(6, 6);
  });
  const Capture capture = load_here();
  EXPECT_EQ(capture.train.size(), 6U);
  EXPECT_EQ(capture.test.size(), 1U);
  EXPECT_TRUE(notes_.contain("2 of 9 frames are in none of the lists"));
}

TEST_F(Split, NamesMatchAsTheyAreUsuallyWritten) {
  const json lists[] = {paths(3, 4, ""),
                        paths(3, 4, "./images/"),
                        paths(3, 4, "images\\"),
                        {"images/view_03", "view_04"},
                        {"IMAGES/VIEW_03.PNG", "view_04.PNG"}};
  for (const json& list : lists) {
    edit([&](json& root) { root["test_filenames"] = list; });
    EXPECT_EQ(names(load_here().test), (Names{"03.png", "04.png"})) << list;
  }
}

TEST_F(Split, NamesOfNoFrameAndOfSeveralAreErrors) {
  edit([](json& root) { root["test_filenames"] = {"images/view_03.png", "images/other.png"}; });
  EXPECT_NE(load_error().find("test_filenames: no frame has the file_path 'images/other.png'"),
            std::string::npos)
      << load_error();
  edit([](json& root) { root["test_filenames"] = json::array({"elsewhere/view_03.png"}); });
  EXPECT_NE(load_error().find("no frame has"), std::string::npos);
  fs::create_directory(folder_ / "more");
  fs::copy_file(folder_ / "images/view_03.png", folder_ / "more/view_03.png");
  edit([](json& root) {
    root["test_filenames"] = json::array({"view_03.png"});
    json again = root["frames"][3];
    again["file_path"] = "more/view_03.png";
    root["frames"].push_back(again);
  });
  EXPECT_NE(load_error().find("'view_03.png' may be images/view_03.png or more/view_03.png"),
            std::string::npos)
      << load_error();
}

TEST_F(Split, AFrameInTrainingAndInAnotherListIsAnError) {
  edit([](json& root) {
    root["train_filenames"] = paths(0, 6);
    root["test_filenames"] = paths(6, 8);
  });
  EXPECT_NE(load_error().find("train_filenames and test_filenames both name images/view_06.png"),
            std::string::npos)
      << load_error();
}

TEST_F(Split, RepeatedFramesAreReadOnce) {
  fs::create_symlink("images", folder_ / "linked");
  edit([](json& root) {
    for (const char* path : {"images/view_00.png", "./images/../images/view_00.png",
                             "images\\view_00.png", "linked/view_00.png", "images/VIEW_00.PNG"}) {
      json again = root["frames"][0];
      again["file_path"] = path;
      root["frames"].push_back(again);
    }
  });
  const Capture capture = load_here();
  EXPECT_EQ(capture.train.size() + capture.test.size(), 9U);
  EXPECT_EQ(names(capture.test), (Names{"00.png", "08.png"}));
  EXPECT_TRUE(notes_.contain("same picture and camera are read once: 5, for example"));
}

TEST_F(Split, ARepeatedPictureWithAnotherCameraIsAnError) {
  edit([](json& root) {
    json again = root["frames"][4];
    again["file_path"] = "images/view_02.png";
    root["frames"].push_back(again);
  });
  EXPECT_NE(load_error().find("frames[9]: names images/view_02.png"), std::string::npos);
  EXPECT_NE(load_error().find("frames[2] does, but with another camera"), std::string::npos)
      << load_error();
}

TEST_F(Split, ThePathOfAJsonFileIsThatFile) {
  json few = json::parse(read_file(folder_ / "transforms.json"));
  few["frames"].erase(few["frames"].begin() + 5, few["frames"].end());
  write_file_atomic(folder_ / "transforms_few.json", few.dump());
  const Capture capture = load(folder_ / "transforms_few.json", notes_);
  EXPECT_EQ(capture.train.size() + capture.test.size(), 5U);
  ASSERT_EQ(capture.files.size(), 6U) << "the camera file and five pictures";
  EXPECT_EQ(fs::path(capture.files[0]).filename(), "transforms_few.json");
  EXPECT_EQ(load(folder_.path(), notes_).files[0], (folder_ / "transforms.json").string());
  EXPECT_NE(error_of([&] {
              (void)load(folder_ / "images/view_00.png", notes_);
            }).find("is not a capture"),
            std::string::npos);
}

TEST_F(Split, AFolderWithOtherJsonFilesNamesOne) {
  fs::rename(folder_ / "transforms.json", folder_ / "cameras.json");
  EXPECT_NE(load_error().find("cameras.json"), std::string::npos) << load_error();
}

TEST(SplitOfNerfSynthetic, ValidationFileWithoutATestFile) {
  testing::TemporaryFolder folder;
  const auto cameras = testing::fixture_cameras(9);
  testing::write_nerf_synthetic(folder.path(), {cameras.begin(), cameras.begin() + 7},
                                {cameras.begin() + 7, cameras.end()});
  fs::rename(folder / "transforms_test.json", folder / "transforms_val.json");
  Progress quiet;
  EXPECT_EQ(load(folder.path(), quiet).train.size(), 7U);
  EXPECT_EQ(load(folder / "transforms_train.json", quiet).test.size(), 2U);
}

TEST(SplitOfNerfSynthetic, APictureInBothSplitsIsAnError) {
  testing::TemporaryFolder folder;
  testing::write_nerf_synthetic(folder.path(), testing::fixture_cameras(9), {});
  fs::copy_file(folder / "transforms_train.json", folder / "transforms_test.json");
  Progress quiet;
  const std::string error = error_of([&] { (void)load(folder.path(), quiet); });
  EXPECT_NE(error.find("the test view train/view_00.png is also a training view"),
            std::string::npos)
      << error;
}

class Models : public ::testing::Test {
 protected:
  /// Writes a model with `count` pictures in sparse/N.
  void write_model(const std::string& name, int count, bool binary = true) {
    const auto write = binary ? testing::write_colmap_binary : testing::write_colmap_text;
    testing::TemporaryFolder other;
    std::vector<testing::FixtureCamera> cameras = testing::fixture_cameras(9);
    cameras.resize(static_cast<size_t>(count));
    write(other.path(), cameras);
    fs::copy(other / "images", folder_ / "images",
             fs::copy_options::recursive | fs::copy_options::skip_existing);
    fs::create_directories(folder_ / "sparse");
    fs::copy(other / "sparse/0", folder_ / ("sparse/" + name), fs::copy_options::recursive);
  }
  [[nodiscard]] static size_t views(const Capture& capture) {
    return capture.train.size() + capture.test.size();
  }
  void edit_text(const std::string& name, const std::function<std::string(std::string)>& change) {
    const fs::path path = folder_ / ("sparse/0/" + name);
    write_file_atomic(path, change(read_file(path)));
  }
  [[nodiscard]] std::string load_error() {
    return error_of([&] { (void)load(folder_.path(), notes_); });
  }

  testing::TemporaryFolder folder_;
  testing::KeepNotes notes_;
};

TEST_F(Models, TheOneWithTheMostPicturesIsRead) {
  write_model("0", 3);
  write_model("1", 9);
  write_model("2", 4, false);
  EXPECT_EQ(views(load(folder_.path(), notes_)), 9U);
  EXPECT_TRUE(notes_.contain("read the COLMAP model sparse/1, which has the most pictures (9)"));
  EXPECT_TRUE(notes_.contain("not read: sparse/0 (3), sparse/2 (4)"));
  EXPECT_EQ(views(load(folder_ / "sparse/2", notes_)), 4U);
  EXPECT_EQ(views(load(folder_ / "sparse/2/cameras.txt", notes_)), 4U);
}

TEST_F(Models, BothEncodingsMayNotDiffer) {
  write_model("0", 8);
  write_model("text", 8, false);
  for (const char* name : {"cameras.txt", "images.txt", "points3D.txt"}) {
    fs::rename(folder_ / (std::string("sparse/text/") + name),
               folder_ / (std::string("sparse/0/") + name));
  }
  EXPECT_EQ(views(load(folder_.path(), notes_)), 8U);
  EXPECT_TRUE(notes_.lines.empty());
  const std::string images = read_file(folder_ / "sparse/0/images.txt");
  edit_text("images.txt", [](std::string text) { return text.substr(0, text.find("\n7 ") + 1); });
  EXPECT_NE(load_error().find("images.bin: differs from images.txt (8 and 6 entries); delete"),
            std::string::npos)
      << load_error();
  write_file_atomic(folder_ / "sparse/0/images.txt", images);
  edit_text("cameras.txt", [](std::string text) {
    return text.replace(text.find("OPENCV 120 90 150"), 17, "OPENCV 120 90 151");
  });
  EXPECT_NE(load_error().find("cameras.bin: differs from cameras.txt"), std::string::npos)
      << load_error();
}

TEST_F(Models, EveryPlaceIsLookedAt) {
  write_model("0", 3);
  write_model("1", 9);
  fs::create_directories(folder_ / "colmap/sparse");
  fs::rename(folder_ / "sparse/1", folder_ / "colmap/sparse/0");
  EXPECT_EQ(views(load(folder_.path(), notes_)), 9U);
  EXPECT_TRUE(notes_.contain("read the COLMAP model colmap/sparse/0"));
  fs::remove(folder_ / "colmap/sparse/0/points3D.bin");
  fs::rename(folder_ / "sparse/0/images.bin", folder_ / "colmap/sparse/0/images.txt");
  fs::remove_all(folder_ / "sparse");
  EXPECT_EQ(views(load(folder_.path(), notes_)), 9U);
  EXPECT_TRUE(notes_.contain("colmap/sparse/0/images.txt is not read"));
}

TEST_F(Models, ImagesTextWithoutPointLines) {
  write_model("0", 9, false);
  const Capture whole = load(folder_.path(), notes_);
  edit_text("images.txt", [](const std::string& text) {
    std::string kept;
    std::istringstream lines(text);
    for (std::string line; std::getline(lines, line);) {
      if (line.find(".png") != std::string::npos) kept += line + "\n";
    }
    return kept;
  });
  const Capture capture = load(folder_.path(), notes_);
  EXPECT_EQ(names(capture.train), names(whole.train));
  EXPECT_EQ(names(capture.test), names(whole.test));
  edit_text("images.txt", [](const std::string& text) { return text + "10.5 20.5\n"; });
  EXPECT_NE(load_error().find("images.txt:10: expected IMAGE_ID"), std::string::npos)
      << load_error();
}

TEST_F(Models, AnIncompleteFileIsNotedOrRefused) {
  write_model("0", 9, false);
  edit_text("images.txt",
            [](const std::string& text) { return "# Number of images: 12, mean: 3\n" + text; });
  EXPECT_EQ(views(load(folder_.path(), notes_)), 9U);
  EXPECT_TRUE(notes_.contain("its comment says 12 images, but it holds 9"));
  fs::remove_all(folder_ / "sparse");
  write_model("0", 9);
  edit_text("images.bin", [](std::string bytes) {
    bytes[0] = 7;
    return bytes;
  });
  EXPECT_NE(load_error().find("bytes after the records that it counts"), std::string::npos)
      << load_error();
}

TEST_F(Models, RepeatedRecords) {
  write_model("0", 9, false);
  edit_text("images.txt", [](const std::string& text) {
    const size_t first = text.find("\n1 ") + 1;
    return text + "77" + text.substr(first + 1, text.find('\n', first) - first) + "\n";
  });
  EXPECT_EQ(views(load(folder_.path(), notes_)), 9U);
  EXPECT_TRUE(notes_.contain("same picture and camera are read once: 1, for example"));
  edit_text("cameras.txt", [](const std::string& text) { return text + text; });
  EXPECT_NE(load_error().find("each CAMERA_ID once, found 1 again"), std::string::npos);
}

}  // namespace
}  // namespace tt3d::capture
