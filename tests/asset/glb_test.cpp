#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <cstring>

#include "asset/asset_fixtures.h"
#include "support/temporary_folder.h"
#include "tt3d/asset.h"
#include "tt3d/image.h"

namespace tt3d::asset {
namespace {

using nlohmann::json;
using testing::asset_error;

/// Writes a sphere, lets `edit` change the JSON and the binary chunk, and saves the result.
class Glb : public ::testing::Test {
 protected:
  void SetUp() override { write_glb(mesh_, path_); }

  void edit(const std::function<void(json&, std::string&)>& change) {
    write_glb(mesh_, path_);
    json root;
    std::string binary;
    testing::split_glb(read_file(path_), root, binary);
    change(root, binary);
    write_file_atomic(path_, testing::make_glb(root, binary));
  }

  void expect_error(const std::function<void(json&, std::string&)>& change,
                    const std::string& expected) {
    edit(change);
    const std::string error = asset_error(path_);
    EXPECT_NE(error.find(expected), std::string::npos) << error << " for " << expected;
  }

  testing::TemporaryFolder folder_;
  std::filesystem::path path_ = folder_ / "object.glb";
  TexturedMesh mesh_ = testing::bumpy_sphere(8, 12);
};

TEST_F(Glb, RoundTripKeepsCornersTextureAndClosedSurface) {
  const TexturedMesh back = load_asset(path_);
  EXPECT_TRUE(at::equal(testing::corner_positions(back), testing::corner_positions(mesh_)));
  EXPECT_TRUE(at::equal(testing::corner_uvs(back), testing::corner_uvs(mesh_)));
  EXPECT_TRUE(at::equal(back.texture, mesh_.texture));
  // Loading welds the seam: 7 rings of 12 vertices and the two poles.
  EXPECT_EQ(back.vertices.size(0), 7 * 12 + 2);
}

TEST_F(Glb, FileFollowsTheSpecification) {
  const std::string bytes = read_file(path_);
  uint32_t length = 0;
  std::memcpy(&length, bytes.data() + 8, 4);
  EXPECT_EQ(length, bytes.size());
  EXPECT_EQ(bytes.size() % 4, 0U);
  json root;
  std::string binary;
  testing::split_glb(bytes, root, binary);
  EXPECT_EQ(root["buffers"][0]["byteLength"], binary.size());
  for (const json& view : root["bufferViews"]) EXPECT_EQ(view["byteOffset"].get<int>() % 4, 0);
  // (x, y, z) is written as (x, z, -y).
  const json& bounds = root["accessors"][0];
  EXPECT_FLOAT_EQ(bounds["max"][1].get<float>(), mesh_.vertices.select(1, 2).max().item<float>());
  EXPECT_FLOAT_EQ(bounds["max"][2].get<float>(), -mesh_.vertices.select(1, 1).min().item<float>());
  EXPECT_EQ(root["extensionsUsed"][0], "KHR_materials_unlit");
  EXPECT_TRUE(root["materials"][0]["extensions"].contains("KHR_materials_unlit"));
  // One vertex per pair of position and uv: the seam twice, each pole once per sector.
  EXPECT_EQ(bounds["count"], 9 * 13);
}

TEST_F(Glb, NodeTransformsAreApplied) {
  edit([](json& root, std::string&) {
    root["nodes"] = {{{"children", {1}}, {"translation", {10, 0, 0}}},
                     {{"mesh", 0}, {"scale", {2, 2, 2}}}};
  });
  // glTF's +x is ours too; scale is applied first.
  const at::Tensor expected = testing::corner_positions(mesh_) * 2 + at::tensor({10.F, 0.F, 0.F});
  EXPECT_TRUE(at::allclose(testing::corner_positions(load_asset(path_)), expected));
  edit([](json& root, std::string&) {
    // A quarter turn about glTF's y (our z): x to -z, which is our y.
    root["nodes"][0]["rotation"] = {0, std::sqrt(0.5), 0, std::sqrt(0.5)};
  });
  const at::Tensor corners = testing::corner_positions(mesh_);
  const at::Tensor turned =
      at::stack({-corners.select(1, 1), corners.select(1, 0), corners.select(1, 2)}, 1);
  EXPECT_TRUE(at::allclose(testing::corner_positions(load_asset(path_)), turned, 1e-5, 1e-5));
}

TEST_F(Glb, MirroringNodesKeepFacesFrontUp) {
  edit([](json& root, std::string&) { root["nodes"][0]["scale"] = {-1, 1, 1}; });
  const at::Tensor corners = testing::corner_positions(load_asset(path_)).view({-1, 3, 3});
  const at::Tensor a = corners.select(1, 0), b = corners.select(1, 1), c = corners.select(1, 2);
  const at::Tensor normal = at::linalg_cross(b - a, c - a);
  const at::Tensor outward = (a + b + c) / 3 - at::tensor({-1.F, 2.F, 3.F});
  EXPECT_GT((normal * outward).sum(1).min().item<float>(), -1e-6);
  // The volume of a ball of about unit radius, 4.19: six times a third of the sum.
  EXPECT_NEAR((normal * outward).sum().item<float>() / 6, 4.19, 0.8);
}

TEST_F(Glb, TwoMaterialsBecomeOneTexture) {
  edit([](json& root, std::string&) {
    root["materials"].push_back(
        {{"pbrMetallicRoughness", {{"baseColorFactor", {1, 0, 0.2158605, 1}}}}});
    json second = root["meshes"][0];
    second["primitives"][0]["material"] = 1;
    root["meshes"].push_back(second);
    root["nodes"].push_back({{"mesh", 1}, {"translation", {5, 0, 0}}});
    root["scenes"][0]["nodes"].push_back(1);
  });
  const TexturedMesh merged = load_asset(path_);
  ASSERT_EQ(merged.faces.size(0), 2 * mesh_.faces.size(0));
  const at::Tensor colours = testing::corner_colours(merged).view({-1, 3, 3});
  const at::Tensor centres = testing::corner_positions(merged).view({-1, 3, 3}).mean(1);
  const at::Tensor is_plain = centres.select(1, 0) > 3;
  const at::Tensor plain = colours.index({is_plain}).view({-1, 3});
  EXPECT_TRUE(at::allclose(plain, at::tensor({255.F, 0.F, 128.F}).expand_as(plain), 0, 1));
  EXPECT_EQ(is_plain.sum().item<int64_t>(), mesh_.faces.size(0));
}

TEST_F(Glb, TransformedUvsWrapAround) {
  // Half of the texture; the uvs lie one tile to the left.
  edit([](json& root, std::string&) {
    root["samplers"][0]["wrapS"] = 10497;
    root["samplers"][0]["wrapT"] = 10497;
    root["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["extensions"] = {
        {"KHR_texture_transform", {{"offset", {-1, 0}}, {"scale", {0.5, 1}}}}};
  });
  const TexturedMesh loaded = load_asset(path_);
  EXPECT_GE(loaded.map.uvs.min().item<float>(), 0);
  EXPECT_LE(loaded.map.uvs.max().item<float>(), 1);
  const at::Tensor expected = testing::corner_uvs(mesh_) * at::tensor({0.5F, 1.F});
  const at::Tensor size = at::tensor({24.F, 16.F});
  const at::Tensor texels =
      testing::corner_uvs(loaded) * at::tensor({static_cast<float>(loaded.texture.size(1)),
                                                static_cast<float>(loaded.texture.size(0))});
  EXPECT_TRUE(at::allclose(texels - texels.amin(0), expected * size, 0, 1e-3));
}

TEST_F(Glb, VertexColoursAreDrawn) {
  edit([](json& root, std::string& binary) {
    const size_t count = root["accessors"][0]["count"];
    const size_t offset = binary.size();
    for (size_t i = 0; i < count; ++i) binary += std::string("\xFF\x00\x37\xFF", 4);
    root["buffers"][0]["byteLength"] = binary.size();
    root["bufferViews"].push_back(
        {{"buffer", 0}, {"byteOffset", offset}, {"byteLength", 4 * count}});
    root["accessors"].push_back({{"bufferView", root["bufferViews"].size() - 1},
                                 {"componentType", 5121},
                                 {"normalized", true},
                                 {"count", count},
                                 {"type", "VEC4"}});
    root["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = root["accessors"].size() - 1;
    root["materials"][0]["pbrMetallicRoughness"].erase("baseColorTexture");
  });
  const at::Tensor colours = testing::corner_colours(load_asset(path_));
  // 55/255 in linear light is sRGB 128.
  EXPECT_TRUE(at::allclose(colours, at::tensor({255.F, 0.F, 128.F}).expand_as(colours), 0, 1.5));
}

TEST_F(Glb, JpegBesideTheAsset) {
  write_file_atomic(folder_ / "skin 1.jpg", image::encode_jpeg(mesh_.texture));
  edit([](json& root, std::string&) { root["images"] = {{{"uri", "skin%201.jpg"}}}; });
  const at::Tensor read = load_asset(path_).texture;
  ASSERT_EQ(read.sizes(), mesh_.texture.sizes());
  const at::Tensor decoded =
      image::decode_image(image::encode_jpeg(mesh_.texture), "x").narrow(2, 0, 3);
  EXPECT_TRUE(at::equal(read, decoded));
  const std::string data = "data:image/png;base64," + base64(image::encode_png(mesh_.texture));
  edit([&](json& root, std::string&) { root["images"] = {{{"uri", data}}}; });
  EXPECT_TRUE(at::equal(load_asset(path_).texture, mesh_.texture));
}

TEST_F(Glb, EveryTruncationIsAnError) {
  const std::string bytes = read_file(path_);
  for (size_t size = 0; size < bytes.size(); size += 1 + bytes.size() / 80) {
    write_file_atomic(path_, bytes.substr(0, size));
    EXPECT_NE(asset_error(path_), "") << size;
  }
}

TEST_F(Glb, WrongContainers) {
  write_file_atomic(path_, std::string(64, 'x'));
  EXPECT_NE(asset_error(path_).find("not a GLB"), std::string::npos);
  EXPECT_NE(asset_error(folder_ / "none.glb").find("cannot open"), std::string::npos);
  write_file_atomic(folder_ / "a.stl", "solid");
  EXPECT_NE(asset_error(folder_ / "a.stl").find(".glb or .obj or .gltf"), std::string::npos);
  expect_error([](json& root, std::string&) { root["asset"]["version"] = "1.0"; }, "version 2");
  expect_error([](json& root, std::string&) { root = json::array(); }, "not valid JSON");
  expect_error(
      [](json& root, std::string&) { root["extensionsRequired"] = {"KHR_draco_mesh_compression"}; },
      "KHR_draco_mesh_compression");
}

TEST_F(Glb, OffsetsAndCountsOutOfRange) {
  expect_error([](json& r, std::string&) { r["accessors"][0]["count"] = 100000; }, "outside");
  expect_error([](json& r, std::string&) { r["accessors"][0]["count"] = 1ULL << 62; }, "outside");
  expect_error([](json& r, std::string&) { r["accessors"][0]["byteOffset"] = ~0ULL; }, "outside");
  expect_error([](json& r, std::string&) { r["bufferViews"][0]["byteOffset"] = ~0ULL - 3; },
               "outside its buffer");
  expect_error([](json& r, std::string&) { r["bufferViews"][0]["byteStride"] = 1ULL << 60; },
               "outside");
  expect_error([](json& r, std::string&) { r["bufferViews"][0]["buffer"] = 7; }, "does not exist");
  expect_error([](json& r, std::string&) { r["buffers"][0]["byteLength"] = 1 << 30; },
               "shorter than its byteLength");
  expect_error([](json& r, std::string&) { r["accessors"][0]["count"] = -1; }, "whole number");
  expect_error([](json& r, std::string&) { r["accessors"][0]["componentType"] = 1; }, "component");
  expect_error([](json& r, std::string&) { r["accessors"][0]["type"] = "MAT4"; }, "VEC3");
}

TEST_F(Glb, ReferencesToNothing) {
  expect_error([](json& r, std::string&) { r["nodes"][0]["mesh"] = 3; }, "meshes[3]");
  expect_error([](json& r, std::string&) { r["scenes"][0]["nodes"] = {9}; }, "nodes[9]");
  expect_error([](json& r, std::string&) { r["textures"][0]["source"] = 2; }, "images[2]");
  expect_error([](json& r, std::string&) { r["meshes"][0]["primitives"][0]["material"] = 5; },
               "materials[5]");
  expect_error([](json& r, std::string&) { r.erase("nodes"); }, "nodes[0]");
  expect_error([](json& r, std::string&) { r["meshes"][0]["primitives"] = json::array(); },
               "no triangles");
}

TEST_F(Glb, CyclicNodes) {
  expect_error(
      [](json& root, std::string&) {
        root["nodes"] = {{{"children", {1}}}, {{"mesh", 0}, {"children", {0}}}};
      },
      "cycle");
}

TEST_F(Glb, IndexOutOfRangeAndNotANumber) {
  expect_error(
      [](json& root, std::string& binary) {
        const size_t view = root["accessors"][3]["bufferView"];
        const size_t offset = root["bufferViews"][view]["byteOffset"];
        const uint32_t index = 123456;
        std::memcpy(binary.data() + offset, &index, sizeof index);
      },
      "points outside");
  expect_error(
      [](json&, std::string& binary) {
        const float nan = std::numeric_limits<float>::quiet_NaN();
        std::memcpy(binary.data(), &nan, sizeof nan);
      },
      "not finite");
}

TEST_F(Glb, Images) {
  expect_error(
      [](json& r, std::string&) {
        r["images"] = {{{"uri", "none.png"}}};
      },
      "no such file");
  for (const char* uri : {"/etc/passwd", "../x.png", "a/../../x.png", "%2e%2e/x.png",
                          "file:///etc/passwd", "..\\\\x.png"}) {
    expect_error([&](json& r, std::string&) { r["images"] = {{{"uri", uri}}}; }, "leads out");
  }
  expect_error(
      [](json& r, std::string&) {
        r["images"] = {{{"uri", "data:image/png;base64,?"}}};
      },
      "base64");
  expect_error([](json& r, std::string&) { r["images"][0]["bufferView"] = 0; },
               "neither PNG nor JPEG");
}

TEST_F(Glb, WrittenForOtherTools) {
  const char* folder = std::getenv("TT3D_ASSET_OUT");
  if (folder == nullptr) GTEST_SKIP() << "run by tests/python/test_assets.py with TT3D_ASSET_OUT";
  write_glb(mesh_, std::filesystem::path(folder) / "object.glb");
  write_obj(mesh_, std::filesystem::path(folder) / "object.obj");
}

TEST_F(Glb, MalformedMeshesAreNotWritten) {
  const auto broken = [&](const std::function<void(TexturedMesh&)>& change) {
    TexturedMesh mesh = testing::bumpy_sphere(4, 5);
    change(mesh);
    EXPECT_THROW(write_glb(mesh, folder_ / "x.glb"), InputError);
    EXPECT_THROW(write_obj(mesh, folder_ / "x.obj"), InputError);
  };
  broken([](TexturedMesh& m) { m.vertices[0][0] = std::numeric_limits<float>::infinity(); });
  broken([](TexturedMesh& m) { m.faces[0][0] = 1000; });
  broken([](TexturedMesh& m) { m.map.faces[0][0] = -1; });
  broken([](TexturedMesh& m) { m.faces = m.faces.narrow(0, 0, 3); });
  broken([](TexturedMesh& m) { m.faces = at::zeros({0, 3}, at::kInt); });
  broken([](TexturedMesh& m) { m.texture = m.texture.to(at::kFloat); });
  EXPECT_FALSE(std::filesystem::exists(folder_ / "x.glb"));
  EXPECT_THROW(write_glb(mesh_, "/proc/none/x.glb"), ResourceError);
}

}  // namespace
}  // namespace tt3d::asset
