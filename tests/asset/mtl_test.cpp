#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include <chrono>

#include "asset/asset_fixtures.h"
#include "support/temporary_folder.h"
#include "tt3d/core.h"
#include "tt3d/image.h"

// OBJ and MTL files as programs write them: names, options, comments, letter case.

namespace tt3d::asset {
namespace {

using testing::asset_error;
using testing::expect_colour;
using testing::expect_four_colours;

/// A unit square of the x-z plane with uvs.
const std::string kSquare = "v 0 0 0\nv 1 0 0\nv 1 0 1\nv 0 0 1\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n";
const std::string kFace = "f 1/1 2/2 3/3 4/4\n";

class Mtl : public ::testing::Test {
 protected:
  void SetUp() override { write("tex.png", image::encode_png(testing::four_colours())); }

  void write(const std::string& name, const std::string& text) {
    write_file_atomic(folder_ / name, text);
  }
  TexturedMesh load(const std::string& obj) {
    write("object.obj", obj);
    notes_.clear();
    return testing::load_with_notes(folder_ / "object.obj", notes_);
  }
  /// Loads the square with a material `one` of this MTL text.
  TexturedMesh load_material(const std::string& mtl) {
    write("m.mtl", mtl);
    return load("mtllib m.mtl\n" + kSquare + "usemtl one\n" + kFace);
  }
  void expect_error(const std::string& obj, const std::string& expected) {
    write("object.obj", obj);
    const std::string error = asset_error(folder_ / "object.obj");
    EXPECT_NE(error.find(expected), std::string::npos) << error << " for " << expected;
  }

  testing::TemporaryFolder folder_;
  std::string notes_;
};

TEST_F(Mtl, QuotedNames) {
  write("my tex.png", read_file(folder_ / "tex.png"));
  write("my model.mtl", "newmtl \"a b\"\nmap_Kd \"my tex.png\"\n");
  expect_four_colours(load("mtllib \"my model.mtl\"\n" + kSquare + "usemtl \"a b\"\n" + kFace));
  expect_four_colours(load("mtllib my model.mtl\n" + kSquare + "usemtl a b\n" + kFace));
}

TEST_F(Mtl, SeveralFilesInOneStatement) {
  write("first.mtl", "newmtl other\nKd 1 0 0\n");
  write("the second.mtl", "newmtl one\nmap_Kd tex.png\n");
  const std::string rest = kSquare + "usemtl one\n" + kFace;
  expect_four_colours(load("mtllib first.mtl \"the second.mtl\"\n" + rest));
  expect_four_colours(load("mtllib first.mtl the second.mtl\n" + rest));
  expect_four_colours(load("mtllib missing.mtl the second.mtl # two\n" + rest));
  expect_error("mtllib first.mtl missing.mtl\n" + rest, "missing.mtl: no such file");
  expect_error("mtllib first.mtl\n" + rest, "material 'one' is in no mtllib");
}

TEST_F(Mtl, LaterStatementsDefineLaterMaterials) {
  write("red.mtl", "newmtl one\nKd 1 0 0\n");
  write("blue.mtl", "newmtl one\nKd 0 0 1\n");
  const TexturedMesh mesh = load(kSquare + "mtllib red.mtl\nusemtl one\nf 1 2 3\n" +
                                 "mtllib blue.mtl\nusemtl one\nf 1 3 4\n");
  expect_colour(mesh, {0.8, 0, 0.2}, {255, 0, 0});
  expect_colour(mesh, {0.2, 0, 0.8}, {0, 0, 255});
}

TEST_F(Mtl, ScaleAndOffset) {
  const TexturedMesh twice = load_material("newmtl one\nmap_Kd -s 2 2 1 tex.png\n");
  expect_colour(twice, {0.125, 0, 0.875}, {220, 30, 30});
  expect_colour(twice, {0.375, 0, 0.875}, {30, 200, 30});
  expect_colour(twice, {0.125, 0, 0.625}, {30, 30, 220});
  expect_colour(twice, {0.625, 0, 0.375}, {220, 30, 30});
  // Half the picture in v, from its middle: the upper half.
  const TexturedMesh half = load_material("newmtl one\nmap_Kd -s 1 0.5 -o 0 .5 0 tex.png\n");
  expect_colour(half, {0.25, 0, 0.1}, {220, 30, 30});
  expect_colour(half, {0.75, 0, 0.9}, {30, 200, 30});
  const TexturedMesh mirrored = load_material("newmtl one\nmap_Kd -s -1 -1 -1 tex.png\n");
  expect_colour(mirrored, {0.25, 0, 0.75}, {230, 220, 40});
}

TEST_F(Mtl, TwoMaterialsUseTheSameUvs) {
  write("m.mtl", "newmtl one\nmap_Kd tex.png\nnewmtl two\nmap_Kd -s 0.25 0.25 tex.png\n");
  const TexturedMesh mesh =
      load("mtllib m.mtl\n" + kSquare + "v 5 0 0\nv 6 0 0\nv 6 0 1\nv 5 0 1\nusemtl one\n" + kFace +
           "usemtl two\nf 5/1 6/2 7/3 8/4\n");
  expect_four_colours(mesh);
  expect_colour(mesh, {5.9, 0, 0.9}, {30, 30, 220});
}

TEST_F(Mtl, OptionsWithoutMeaningHereAreSkipped) {
  write("10 tex 1.png", read_file(folder_ / "tex.png"));
  write("-odd.png", read_file(folder_ / "tex.png"));
  for (const char* statement :
       {"-blendu on -blendv off -boost 1.5 -cc off -imfchan l tex.png", "-mm 0 1 tex.png",
        "-t 0.1 tex.png", "-t 0.1 0.2 0.3 tex.png", "-texres 512 -bm 0.5 tex.png", "-s 1 tex.png",
        "-s 1 1 tex.png", "-s 1 1 1 -o 0 0 0 tex.png", "-clamp on tex.png", "-BM 1 tex.png",
        "-s 1 1 1 10 tex 1.png", "-bm 1 \"10 tex 1.png\" # bumps", "-odd.png", "./tex.png",
        "TEX.PNG", "missing\\folder\\tex.png", "C:\\Users\\me\\scan\\tex.png",
        "/home/me/tex.png"}) {
    SCOPED_TRACE(statement);
    expect_four_colours(load_material(std::string("newmtl one\nmap_Kd ") + statement + "\n"));
  }
}

TEST_F(Mtl, ClampedTexture) {
  const TexturedMesh mesh = load_material("newmtl one\nmap_Kd -clamp on -s 4 4 tex.png\n");
  expect_colour(mesh, {0.9, 0, 0.9}, {30, 200, 30});
  expect_colour(mesh, {0.05, 0, 0.05}, {30, 30, 220});
}

TEST_F(Mtl, LetterCaseOfKeywords) {
  for (const char* key : {"map_kd", "MAP_KD", "map_KD", "\tmap_Kd"}) {
    expect_four_colours(load_material(std::string("NewMtl one\n") + key + " tex.png\n"));
  }
  write("m.mtl", "NEWMTL one\nKD 1 0 0\n");
  expect_colour(load("MtlLib m.mtl\n" + kSquare + "UseMtl one\nF 1 2 3\n"), {0.8, 0, 0.2},
                {255, 0, 0});
}

TEST_F(Mtl, EmptyStatements) {
  for (const char* empty : {"map_Kd", "map_Kd ", "map_Kd # none", "map_Kd \"\"", "map_Kd -s 1 1 1",
                            "map_Kd -bm", "map_Ke", "newmtl\nKd 1 1 1"}) {
    SCOPED_TRACE(empty);
    expect_colour(load_material(std::string("newmtl one\nKd 0.5 0.25 0.125\n") + empty + "\n"),
                  {0.5, 0, 0.5}, {128, 64, 32});
  }
  expect_colour(load("mtllib\nmtllib  \n" + kSquare + "usemtl\n" + kFace), {0.5, 0, 0.5},
                {255, 255, 255});
}

TEST_F(Mtl, CommentsAtLineEnds) {
  write("m.mtl",
        "# materials\nnewmtl one # the only one\nKd 1 1 1 # white\nmap_Kd tex.png # skin\n");
  const TexturedMesh mesh = load(
      "mtllib m.mtl # here\nv 0 0 0 # a\nv 1 0 0\t# 1 1 1\nv 1 0 1\nv 0 0 1\nvt 0 0 # b\n"
      "vt 1 0\nvt 1 1\nvt 0 1\nusemtl one # c\nf 1/1 2/2 3/3 4/4 # d \\\n");
  expect_four_colours(mesh);
}

TEST_F(Mtl, NumberSignsInNames) {
  write("m.mtl", "newmtl Material #1\nKd 1 0 0\nnewmtl Material #2\nKd 0 0 1\n");
  const TexturedMesh mesh = load("mtllib m.mtl\n" + kSquare +
                                 "usemtl Material #1\nf 1 2 3\nusemtl Material #2\nf 1 3 4\n");
  expect_colour(mesh, {0.8, 0, 0.2}, {255, 0, 0});
  expect_colour(mesh, {0.2, 0, 0.8}, {0, 0, 255});
  expect_error("mtllib m.mtl\n" + kSquare + "usemtl Material #3\nf 1 2 3\n", "'Material #3' is in");
  write("a #1.png", read_file(folder_ / "tex.png"));
  expect_four_colours(load_material("newmtl one\nmap_Kd a #1.png\n"));
}

TEST_F(Mtl, GreyColourAndEmission) {
  expect_colour(load_material("newmtl one\nKd 0.5 # grey\n"), {0.5, 0, 0.5}, {128, 128, 128});
  expect_colour(load_material("newmtl one\nKd 0 0 0\nKe 1 0.5 0\n"), {0.5, 0, 0.5}, {255, 128, 0});
  EXPECT_NE(notes_.find("its emission (Ke, map_Ke) is read"), std::string::npos) << notes_;
  expect_four_colours(load_material("newmtl one\nKd 0 0 0\nmap_Ke tex.png\n"));
  expect_colour(load_material("newmtl one\nKd 1 0 0\nmap_Ke tex.png\n"), {0.5, 0, 0.5},
                {255, 0, 0});
}

TEST_F(Mtl, FacesWithoutUvsAreNoted) {
  write("m.mtl", "newmtl one\nmap_Kd tex.png\n");
  (void)load("mtllib m.mtl\n" + kSquare + "usemtl one\nf 1 2 3\n");
  EXPECT_NE(notes_.find("faces without vt have a texture"), std::string::npos) << notes_;
}

TEST_F(Mtl, UnusedMaterialsNeedNoTexture) {
  write("m.mtl", "newmtl one\nmap_Kd tex.png\nnewmtl two\nmap_Kd not-shipped.png\n");
  const std::string text = "mtllib m.mtl\n" + kSquare + "usemtl two\nusemtl one\n" + kFace;
  expect_four_colours(load(text));
  expect_error(text + "usemtl two\n" + kFace, "not-shipped.png: no such file");
}

TEST_F(Mtl, FilesAreReadOnce) {
  const at::Tensor noise = at::randint(0, 256, {1500, 1500, 3}, at::kByte);
  write("tex.png", image::encode_png(noise));
  write("m.mtl", "newmtl one\nmap_Kd tex.png\n");
  const auto seconds = [&](int groups) {
    std::string text = kSquare;
    for (int i = 0; i < groups; ++i) text += "mtllib m.mtl\nusemtl one\n" + kFace;
    const auto start = std::chrono::steady_clock::now();
    EXPECT_TRUE(at::equal(load(text).texture, noise));
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  };
  const double once = seconds(1);
  EXPECT_LT(seconds(200), 5 * once + 0.5);
}

TEST_F(Mtl, OnePictureOfTwoMaterialsIsOneTexture) {
  write("copy.png", read_file(folder_ / "tex.png"));
  write("m.mtl", "newmtl one\nmap_Kd tex.png\nnewmtl two\nmap_Kd copy.png\n");
  const TexturedMesh mesh =
      load("mtllib m.mtl\n" + kSquare + "usemtl one\nf 1/1 2/2 3/3\nusemtl two\nf 1/1 3/3 4/4\n");
  EXPECT_EQ(mesh.texture.size(0), 64);
  expect_four_colours(mesh);
}

TEST_F(Mtl, MissingLibraryMattersOnlyForItsMaterials) {
  EXPECT_NO_THROW((void)load("mtllib missing.mtl\n" + kSquare + kFace));
  expect_error("mtllib missing.mtl\n" + kSquare + "usemtl one\n" + kFace,
               "missing.mtl: no such file");
}

TEST_F(Mtl, AnotherFolder) {
  write("sub/m.mtl", "newmtl one\nmap_Kd tex.png\n");  // the picture is beside the OBJ
  const std::string rest = kSquare + "usemtl one\n" + kFace;
  expect_four_colours(load("mtllib sub\\m.mtl\n" + rest));
  expect_four_colours(load("mtllib Sub/M.MTL\n" + rest));
}

TEST_F(Mtl, TextWithByteOrderMarkAndOtherLineEnds) {
  write("m.mtl", "\xEF\xBB\xBFnewmtl one\r\nmap_Kd tex.png\r\n");
  std::string text = "\xEF\xBB\xBFmtllib m.mtl\n" + kSquare + "usemtl one\n" + kFace;
  expect_four_colours(load(text));
  std::replace(text.begin(), text.end(), '\n', '\r');
  expect_four_colours(load(text));
  expect_error(std::string("\xFF\xFEv\0 \0", 6), "UTF-16");
}

}  // namespace
}  // namespace tt3d::asset
