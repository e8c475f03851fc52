#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include <fstream>

#include "capture/synthetic_capture.h"
#include "support/temporary_folder.h"
#include "tt3d/capture.h"
#include "tt3d/image.h"

// Every error in a capture is one line that names the file and the problem.

namespace tt3d::capture {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

std::string load_error(const fs::path& folder, const std::string& format = "auto") {
  try {
    (void)testing::load(folder, format);
  } catch (const InputError& error) {
    EXPECT_EQ(std::string(error.what()).find('\n'), std::string::npos) << error.what();
    return error.what();
  }
  ADD_FAILURE() << "loaded without an error";
  return "";
}

/// A valid capture in its own folder; each test damages it.
class Malformed : public ::testing::Test {
 protected:
  void SetUp() override {
    const auto cameras = testing::fixture_cameras(10);
    testing::write_nerfstudio(folder_.path(), cameras);
  }

  /// After `edit` of the first frame, the error must contain `expected` and the camera file's name.
  void expect_frame_error(const std::function<void(json&)>& edit, const std::string& expected) {
    testing::edit_json(file(), [&](json& root) { edit(root["frames"][0]); });
    const std::string error = load_error(folder_.path());
    EXPECT_NE(error.find(expected), std::string::npos) << error;
    EXPECT_NE(error.find("frames[0]"), std::string::npos) << error;
    EXPECT_NE(error.find(file().string()), std::string::npos) << error;
  }

  void expect_error(const std::string& expected, const std::string& name) {
    const std::string error = load_error(folder_.path());
    EXPECT_NE(error.find(expected), std::string::npos) << error;
    EXPECT_NE(error.find(name), std::string::npos) << error;
  }

  [[nodiscard]] fs::path file() const { return folder_ / "transforms.json"; }
  [[nodiscard]] fs::path image() const { return folder_ / "images/view_03.png"; }

  testing::TemporaryFolder folder_;
};

TEST_F(Malformed, FolderWithoutACapture) {
  testing::TemporaryFolder empty;
  EXPECT_NE(load_error(empty.path()).find("contains no capture"), std::string::npos);
  EXPECT_NE(load_error(empty / "none").find("no such folder"), std::string::npos);
  EXPECT_NE(load_error(folder_.path(), "obj").find("expected one of auto"), std::string::npos);
  EXPECT_NE(load_error(folder_.path(), "colmap").find("no COLMAP model"), std::string::npos);
}

TEST_F(Malformed, JsonErrorsHaveALine) {
  write_file_atomic(file(), "{\n\"frames\": [\n{\"w\": NaN}\n]}");
  expect_error("transforms.json:3: is not valid JSON", "transforms.json");
  write_file_atomic(file(), "{\"frames\": [{\"w\": 1e999}]}");
  expect_error("out of range", "transforms.json");
  write_file_atomic(file(), "");
  expect_error("empty", "transforms.json");
  write_file_atomic(file(), "[]");
  expect_error("'frames'", "transforms.json");
}

TEST_F(Malformed, NoFrames) {
  testing::edit_json(file(), [](json& root) { root["frames"] = json::array(); });
  expect_error("'frames' is empty", "transforms.json");
}

TEST_F(Malformed, NotANumberInTheMatrix) {
  expect_frame_error([](json& frame) { frame["transform_matrix"][1][2] = nullptr; },
                     "transform_matrix[1][2]: expected a finite number");
}

TEST_F(Malformed, SingularMatrix) {
  expect_frame_error(
      [](json& frame) {
        for (int r = 0; r < 3; ++r) frame["transform_matrix"][r][0] = 0;
      },
      "singular");
}

TEST_F(Malformed, MirroredMatrix) {
  expect_frame_error(
      [](json& frame) {
        for (int r = 0; r < 3; ++r) {
          auto& value = frame["transform_matrix"][r][0];
          value = -value.get<double>();
        }
      },
      "mirrors");
}

TEST_F(Malformed, ScaledMatrix) {
  expect_frame_error(
      [](json& frame) {
        for (int r = 0; r < 3; ++r) {
          auto& value = frame["transform_matrix"][r][1];
          value = 1.2 * value.get<double>();
        }
      },
      "not a rotation");
}

TEST_F(Malformed, MatrixOfAnotherShape) {
  expect_frame_error(
      [](json& frame) {
        frame["transform_matrix"] = {{1, 2}, {3, 4}};
      },
      "4 rows of 4 numbers");
}

TEST_F(Malformed, PathsOutsideTheFolder) {
  for (const char* path : {"/etc/passwd", "../secret.png", "images/../../secret.png", ".."}) {
    expect_frame_error([&](json& frame) { frame["file_path"] = path; }, "leads out");
  }
  expect_frame_error(
      [](json& frame) {
        frame["file_path"] = "images/view_00.png";
        frame["mask_path"] = "/tmp/mask.png";
      },
      "leads out");
  expect_frame_error([](json& frame) { frame["file_path"] = ""; }, "expected the path");
}

TEST_F(Malformed, MissingImageAndMask) {
  fs::remove(image());
  expect_error("no such image", "view_03.png");
  expect_frame_error([](json& frame) { frame["mask_path"] = "none.png"; }, "no such mask");
}

TEST_F(Malformed, EmptyTruncatedAndCorruptImages) {
  const std::string bytes = read_file(image());
  write_file_atomic(image(), "");
  expect_error("empty", "view_03.png");
  write_file_atomic(image(), bytes.substr(0, bytes.size() / 2));
  expect_error("truncated", "view_03.png");
  std::string corrupt = bytes;
  corrupt[bytes.size() / 2] = static_cast<char>(corrupt[bytes.size() / 2] ^ 0x40);
  write_file_atomic(image(), corrupt);
  expect_error("cannot decode", "view_03.png");
  write_file_atomic(image(), "no image");
  expect_error("neither PNG nor JPEG", "view_03.png");
}

TEST_F(Malformed, ImageSizeDisagrees) {
  write_file_atomic(image(), image::encode_png(at::zeros({64, 64, 4}, at::kByte)));
  expect_error("is 64x64 pixels", "view_03.png");
  expect_error("says 120x90", "frames[3]");
}

TEST_F(Malformed, MaskSizeDisagrees) {
  write_file_atomic(folder_ / "m.png", image::encode_png(at::zeros({8, 8, 1}, at::kByte)));
  testing::edit_json(file(), [](json& root) { root["frames"][0]["mask_path"] = "m.png"; });
  expect_error("expected the size of its image", "m.png");
}

TEST_F(Malformed, SomeImagesWithoutMasks) {
  write_file_atomic(image(), image::encode_png(image::read_image(image()).narrow(2, 0, 3)));
  expect_error("neither alpha nor a mask", "view_03.png");
}

TEST_F(Malformed, Lenses) {
  expect_frame_error([](json& frame) { frame["k3"] = 0.1; }, "undistort");
  expect_frame_error(
      [](json& frame) {
        frame["k3"] = 0;
        frame["camera_model"] = "OPENCV_FISHEYE";
      },
      "not supported");
  expect_frame_error(
      [](json& frame) {
        frame["camera_model"] = "OPENCV";
        frame["fl_x"] = -5;
      },
      "focal length");
  expect_frame_error([](json& frame) { frame["fl_x"] = "wide"; }, "finite number");
}

TEST_F(Malformed, ObjectNeverInView) {
  for (const auto& entry : fs::directory_iterator(folder_ / "images")) {
    const at::Tensor rgba = image::read_image(entry.path());
    rgba.select(2, 3).zero_();
    write_file_atomic(entry.path(), image::encode_png(rgba));
  }
  expect_error("never enters the view", folder_.path().string());
}

TEST_F(Malformed, MasksThatMeetNowhere) {
  // All cameras turned away from the object; the pictures are unchanged.
  testing::edit_json(file(), [](json& root) {
    for (auto& frame : root["frames"]) {
      for (int r = 0; r < 3; ++r) {
        for (const int c : {0, 2}) {
          auto& value = frame["transform_matrix"][r][c];
          value = -value.get<double>();
        }
      }
    }
  });
  expect_error("never enters the view", folder_.path().string());
}

TEST_F(Malformed, OneView) {
  testing::edit_json(file(), [](json& root) {
    const json first = root["frames"][0];
    root["frames"] = json::array({first});
  });
  expect_error("fewer than two views", folder_.path().string());
}

class MalformedColmap : public ::testing::Test {
 protected:
  void SetUp() override {
    testing::write_colmap_text(text_.path(), testing::fixture_cameras(6));
    testing::write_colmap_binary(binary_.path(), testing::fixture_cameras(6));
  }
  void replace(const std::string& name, const std::string& from, const std::string& to) {
    std::string content = read_file(text_ / name);
    const size_t at = content.find(from);
    ASSERT_NE(at, std::string::npos);
    write_file_atomic(text_ / name, content.replace(at, from.size(), to));
  }
  testing::TemporaryFolder text_, binary_;
};

TEST_F(MalformedColmap, TextErrorsHaveALine) {
  replace("sparse/0/cameras.txt", "OPENCV", "SQUINT");
  EXPECT_NE(load_error(text_.path()).find("cameras.txt:2:"), std::string::npos);
  replace("sparse/0/cameras.txt", "SQUINT", "OPENCV_FISHEYE");
  EXPECT_NE(load_error(text_.path()).find("OPENCV_FISHEYE is not supported"), std::string::npos);
  replace("sparse/0/cameras.txt", "OPENCV_FISHEYE 120", "OPENCV x");
  EXPECT_NE(load_error(text_.path()).find("cameras.txt:2:"), std::string::npos);
}

TEST_F(MalformedColmap, NamesThatLeadOut) {
  replace("sparse/0/images.txt", "view_00.png", "../../x.png");
  EXPECT_NE(load_error(text_.path()).find("images.txt:2: '../../x.png' leads out"),
            std::string::npos);
}

TEST_F(MalformedColmap, RotationThatIsNone) {
  const std::string content = read_file(text_ / "sparse/0/images.txt");
  const size_t line = content.find("\n1 ") + 1;
  write_file_atomic(text_ / "sparse/0/images.txt",
                    content.substr(0, line) + "1 nan 0 0 0 0 0 0 1 view_00.png\n\n");
  EXPECT_NE(load_error(text_.path()).find("not a unit quaternion"), std::string::npos);
}

TEST_F(MalformedColmap, NoImages) {
  write_file_atomic(text_ / "sparse/0/images.txt", "# nothing\n");
  EXPECT_NE(load_error(text_.path()).find("contains no images"), std::string::npos);
}

TEST_F(MalformedColmap, EveryTruncationOfBinaryIsAnError) {
  for (const char* name : {"cameras.bin", "images.bin", "points3D.bin"}) {
    const fs::path path = binary_ / (std::string("sparse/0/") + name);
    const std::string bytes = read_file(path);
    for (size_t size = 0; size < bytes.size(); size += 1 + bytes.size() / 12) {
      write_file_atomic(path, bytes.substr(0, size));
      EXPECT_NE(load_error(binary_.path()).find(name), std::string::npos) << name << " " << size;
    }
    write_file_atomic(path, bytes);
  }
  (void)testing::load(binary_.path());
}

TEST_F(MalformedColmap, HugeCountsAreErrorsNotAllocations) {
  const fs::path path = binary_ / "sparse/0/images.bin";
  std::string bytes = read_file(path);
  std::fill_n(bytes.begin(), 8, '\xFF');
  write_file_atomic(path, bytes);
  EXPECT_NE(load_error(binary_.path()).find("truncated or corrupt"), std::string::npos);
}

}  // namespace
}  // namespace tt3d::capture
