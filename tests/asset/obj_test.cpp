#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include "asset/asset_fixtures.h"
#include "support/temporary_folder.h"
#include "tt3d/asset.h"
#include "tt3d/image.h"

namespace tt3d::asset {
namespace {

using testing::asset_error;

class Obj : public ::testing::Test {
 protected:
  TexturedMesh load(const std::string& text) {
    write_file_atomic(path_, text);
    return load_asset(path_);
  }
  void expect_error(const std::string& text, const std::string& expected) {
    write_file_atomic(path_, text);
    const std::string error = asset_error(path_);
    EXPECT_NE(error.find(expected), std::string::npos) << error << " for " << text;
  }

  testing::TemporaryFolder folder_;
  std::filesystem::path path_ = folder_ / "object.obj";
};

TEST_F(Obj, RoundTripIsExactInGeometryAndTexture) {
  const TexturedMesh mesh = testing::bumpy_sphere(8, 12);
  write_obj(mesh, path_);
  const TexturedMesh back = load_asset(path_);
  EXPECT_TRUE(at::equal(back.vertices, mesh.vertices));
  EXPECT_TRUE(at::equal(back.faces, mesh.faces));
  EXPECT_TRUE(at::equal(back.map.faces, mesh.map.faces));
  EXPECT_TRUE(at::allclose(back.map.uvs, mesh.map.uvs, 0, 1e-7));
  EXPECT_TRUE(at::equal(back.texture, mesh.texture));
}

TEST_F(Obj, MaterialIsMatteAndOpaque) {
  write_obj(testing::bumpy_sphere(4, 5), path_);
  const std::string mtl = read_file(folder_ / "object.mtl");
  EXPECT_NE(mtl.find("Kd 1 1 1\n"), std::string::npos);
  EXPECT_NE(mtl.find("Ks 0 0 0\n"), std::string::npos);
  EXPECT_NE(mtl.find("map_Kd object.png\n"), std::string::npos);
  EXPECT_EQ(mtl.find("Tr"), std::string::npos);
}

TEST_F(Obj, PolygonsNegativeIndicesNormalsAndContinuations) {
  const TexturedMesh mesh = load(
      "# a square\r\nv 0 0 0\r\nv 1 0 0\nv 1 1 0 1.0\nv 0 1 0\nvn 0 0 1\n"
      "g side\ns off\nf -4//1 2//1 \\\n -2//1 4//1\n");
  const at::Tensor expected = at::tensor({0, 1, 2, 0, 2, 3}, at::kInt).view({2, 3});
  EXPECT_TRUE(at::equal(mesh.faces, expected));
  const at::Tensor colours = testing::corner_colours(mesh);
  EXPECT_EQ(colours.min().item<float>(), 255);  // no material: white
}

TEST_F(Obj, ColoursOfMaterialsWithoutTexture) {
  write_file_atomic(folder_ / "m.mtl", "newmtl red\nKd 1 0 0\nnewmtl grey\nKd 0.5 0.5 0.5\n");
  const TexturedMesh mesh = load(
      "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
      "usemtl red\nf 1 2 3\nusemtl grey\nf 1 3 4\n");
  const at::Tensor colours = testing::corner_colours(mesh);
  EXPECT_TRUE(at::equal(colours[0], at::tensor({255.F, 0.F, 0.F})));
  EXPECT_TRUE(at::allclose(colours[5], at::tensor({128.F, 128.F, 128.F}), 0, 1));
}

TEST_F(Obj, VertexColoursAreExactAtTheCorners) {
  const TexturedMesh mesh = load("v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nf 1 2 3\n");
  EXPECT_TRUE(at::equal(testing::corner_colours(mesh), at::eye(3) * 255));
}

TEST_F(Obj, VertexColoursAsBytesAndAfterPlainVertices) {
  const TexturedMesh mesh =
      load("v 0 0 0\nv 1 0 0 255 0 0\nv 0 1 0 0 255 0\nv 1 1 0 0 0 51\nf 2 4 3\nf 1 2 3\n");
  const at::Tensor colours = testing::corner_colours(mesh);
  EXPECT_TRUE(at::equal(colours[0], at::tensor({255.F, 0.F, 0.F})));
  EXPECT_TRUE(at::equal(colours[1], at::tensor({0.F, 0.F, 51.F})));
  EXPECT_EQ(colours.narrow(0, 3, 3).min().item<float>(), 255);  // a corner has no colour: white
}

TEST_F(Obj, ConcavePolygon) {
  const TexturedMesh mesh =
      load("v 2 1 0\nv 1 1 0\nv 1 2 0\nv 0 2 0\nv 0 0 0\nv 2 0 0\nf 1 2 3 4 5 6\n");
  EXPECT_NEAR(testing::surface_area(mesh), 3, 1e-6);
  EXPECT_EQ(mesh.faces.size(0), 4);
}

TEST_F(Obj, LongConcavePolygonsAreRefused) {
  std::string text, face = "f";
  for (int i = 0; i < 6000; ++i) {
    const std::string x = std::to_string(i);
    text.append("v ").append(x).append(" 1 0\nv ").append(x).append(".5 0.1 0\n");
    face.append(" ").append(std::to_string(2 * i + 1));
    face.append(" ").append(std::to_string(2 * i + 2));
  }
  text.append("v 0 -1 0\n").append(face).append(" -1\n");
  expect_error(text, "split the face into triangles");
}

TEST_F(Obj, TinyNumbersAreZeroAndHugeOnesRefused) {
  const TexturedMesh mesh =
      load("v 1e-50 0 -4.9e-324\nv 1 1e-400 0\nv 1 1 0\nvt 1e-300 0\nf 1/1 2/1 3/1\n");
  EXPECT_NEAR(testing::surface_area(mesh), 0.5, 1e-6);
  EXPECT_EQ(mesh.vertices[0].abs().max().item<float>(), 0);
  expect_error("v 1e400 0 0\n", "object.obj:1:");
  expect_error("v 0 0 0\nvt 1e39 0\n", "object.obj:2:");
}

TEST_F(Obj, TwoTexturesKeepTheirTexels) {
  const at::Tensor first = at::full({8, 8, 3}, 200, at::kByte);
  const at::Tensor second =
      at::arange(20 * 10 * 3, at::kInt).remainder(250).to(at::kByte).view({20, 10, 3});
  write_file_atomic(folder_ / "a b.png", image::encode_png(first));
  write_file_atomic(folder_ / "sub/c.png", image::encode_png(second));
  write_file_atomic(folder_ / "m.mtl",
                    "newmtl one\nmap_Kd a b.png\nnewmtl two\nmap_Kd -bm 1 sub\\c.png\n");
  const TexturedMesh mesh = load(
      "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.05 0.975\nvt 0.95 0.975\nvt 0.05 0.025\n"
      "usemtl one\nf 1/1 2/2 3/3\nusemtl two\nf 1/1 2/2 3/3\n");
  const at::Tensor colours = testing::corner_colours(mesh);
  EXPECT_EQ(colours[0][0].item<float>(), 200);
  // v = 0.975 counts from the bottom: row 0; 0.05 is column 0, 0.95 column 9.
  EXPECT_TRUE(at::equal(colours[3], second[0][0].to(at::kFloat)));
  EXPECT_TRUE(at::equal(colours[4], second[0][9].to(at::kFloat)));
  EXPECT_TRUE(at::equal(colours[5], second[19][0].to(at::kFloat)));
}

TEST_F(Obj, RepeatedTextureIsTiled) {
  const at::Tensor image = at::arange(4 * 4 * 3, at::kInt).mul(5).to(at::kByte).view({4, 4, 3});
  write_file_atomic(folder_ / "a.png", image::encode_png(image));
  write_file_atomic(folder_ / "m.mtl", "newmtl one\nmap_Kd a.png\n");
  const TexturedMesh mesh = load(
      "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt -2.125 0.875\nvt 0.125 0.875\nvt -1.125 -0.875\n"
      "usemtl one\nf 1/1 2/2 3/3\n");
  EXPECT_LE(mesh.map.uvs.max().item<float>(), 1);
  EXPECT_GE(mesh.map.uvs.min().item<float>(), 0);
  const at::Tensor colours = testing::corner_colours(mesh);
  EXPECT_TRUE(at::equal(colours[0], image[0][3].to(at::kFloat)));
  EXPECT_TRUE(at::equal(colours[1], image[0][0].to(at::kFloat)));
  EXPECT_TRUE(at::equal(colours[2], image[3][3].to(at::kFloat)));
}

TEST_F(Obj, TextureThatRepeatsTooOftenIsRefused) {
  write_file_atomic(folder_ / "a.png", image::encode_png(at::zeros({4, 4, 3}, at::kByte)));
  write_file_atomic(folder_ / "m.mtl", "newmtl one\nmap_Kd a.png\n");
  expect_error(
      "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1e9 0\nvt 0 1\n"
      "usemtl one\nf 1/1 2/2 3/3\n",
      "repeats more than");
}

TEST_F(Obj, ErrorsHaveALine) {
  const std::string triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
  expect_error("", "no faces");
  expect_error(triangle, "no faces");
  expect_error(triangle + "f 1 2 4\n", "object.obj:4: expected an index");
  expect_error(triangle + "f 1 2 -4\n", "object.obj:4:");
  expect_error(triangle + "f 0 1 2\n", "object.obj:4:");
  expect_error(triangle + "f 1 2\n", "three corners");
  expect_error(triangle + "f 1/1 2/2 3/3\n", "object.obj:4:");
  expect_error(triangle + "f a b c\n", "found 'a'");
  expect_error("v 0 nan 0\n", "object.obj:1:");
  expect_error("v 0 1e99 0\n", "object.obj:1:");
  expect_error("v 0 0\n", "object.obj:1:");
  expect_error("vt x\n", "object.obj:1:");
  expect_error(triangle + "usemtl none\nf 1 2 3\n", "object.obj:4: material 'none'");
}

TEST_F(Obj, ReferencedFiles) {
  const std::string triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl one\nf 1 2 3\n";
  expect_error("mtllib none.mtl\n" + triangle, "no such file");
  expect_error("mtllib ../m.mtl\n" + triangle, "leads out");
  expect_error("mtllib /etc/passwd\n" + triangle, "leads out");
  write_file_atomic(folder_ / "m.mtl", "newmtl one\nmap_Kd none.png\n");
  expect_error("mtllib m.mtl\n" + triangle, "no such file");
  write_file_atomic(folder_ / "m.mtl", "newmtl one\nmap_Kd ../secret.png\n");
  expect_error("mtllib m.mtl\n" + triangle, "leads out");
  write_file_atomic(folder_ / "m.mtl", "newmtl one\nKd 1 x 0\n");
  expect_error("mtllib m.mtl\n" + triangle, "m.mtl:2:");
}

}  // namespace
}  // namespace tt3d::asset
