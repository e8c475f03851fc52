#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include "asset/gltf_builder.h"
#include "support/temporary_folder.h"
#include "tt3d/core.h"

// Geometry of glTF files at rest: skins, morph targets, instances, quantised and sparse accessors.

namespace tt3d::asset {
namespace {

using nlohmann::json;
using testing::asset_error;
using testing::GltfBuilder;
using testing::kByte;
using testing::kFloat;
using testing::kShort;
using testing::kSignedByte;
using testing::kSignedShort;

class GlbGeometry : public ::testing::Test {
 protected:
  TexturedMesh load() {
    glb_.save(path_);
    return load_asset(path_);
  }
  void expect_error(const std::string& expected) {
    glb_.save(path_);
    const std::string error = asset_error(path_);
    EXPECT_NE(error.find(expected), std::string::npos) << error << " for " << expected;
  }
  void expect_bounds(const std::vector<float>& low, const std::vector<float>& high) {
    const TexturedMesh mesh = load();
    const at::Tensor found_low = std::get<0>(mesh.vertices.min(0));
    const at::Tensor found_high = std::get<0>(mesh.vertices.max(0));
    EXPECT_TRUE(at::allclose(found_low, at::tensor(low), 0, 1e-5)) << found_low;
    EXPECT_TRUE(at::allclose(found_high, at::tensor(high), 0, 1e-5)) << found_high;
  }
  json& attributes() { return glb_.primitive()["attributes"]; }

  /// A skin whose first joint is node 1 at +2 x, and whose second is node 2 at +4 y (glTF).
  void add_skin() {
    glb_.root["nodes"] = {{{"mesh", 0}, {"skin", 0}, {"translation", {0, 1, 0}}},
                          {{"translation", {2, 0, 0}}, {"children", {2}}},
                          {{"translation", {-2, 4, 0}}},
                          {{"children", {0}}, {"translation", {1, 0, 0}}}};
    glb_.root["scenes"][0]["nodes"] = {3, 1};
    glb_.root["skins"] = {{{"joints", {1, 2}}}};
    attributes()["JOINTS_0"] =
        glb_.accessor<uint8_t>({0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 1, 0, 0, 0}, kByte, "VEC4");
    attributes()["WEIGHTS_0"] =
        glb_.accessor<float>({1, 0, 0, 0, 1, 0, 0, 0, 0.5, 0.5, 0, 0, 1, 0, 0, 0}, kFloat, "VEC4");
  }

  testing::TemporaryFolder folder_;
  std::filesystem::path path_ = folder_ / "object.glb";
  GltfBuilder glb_;
};

TEST_F(GlbGeometry, SkinsFollowTheirJointsAlone) {
  add_skin();
  // The square's corners: (2,0), (3,0), the mean of (3,1) and (1,5), (0,5); glTF's y is our z.
  expect_bounds({0, 0, 0}, {3, 0, 5});
  const TexturedMesh mesh = load();
  EXPECT_TRUE(at::allclose(mesh.vertices[2], at::tensor({2.F, 0.F, 3.F})));
}

TEST_F(GlbGeometry, InverseBindMatricesAndWeightsAsIntegers) {
  add_skin();
  const std::vector<float> matrices = {
      1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, -2, 0, 0, 1,  // undoes the first joint
      1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0,  0, 0, 1};
  glb_.root["skins"][0]["inverseBindMatrices"] = glb_.accessor<float>(matrices, kFloat, "MAT4");
  attributes()["WEIGHTS_0"] = glb_.accessor<uint8_t>(
      {255, 0, 0, 0, 255, 0, 0, 0, 255, 0, 0, 0, 255, 0, 0, 0}, kByte, "VEC4", true);
  expect_bounds({0, 0, 0}, {1, 0, 5});
}

TEST_F(GlbGeometry, MalformedSkins) {
  add_skin();
  glb_.root["skins"][0]["joints"] = {1};
  expect_error("names a joint outside its skin's 1");
  glb_.root["skins"][0]["joints"] = {1, 9};
  expect_error("nodes[9]");
  glb_.root["skins"] = json::array();
  expect_error("skins[0]");
  add_skin();
  attributes()["WEIGHTS_0"] = glb_.accessor<float>(std::vector<float>(16, 0), kFloat, "VEC4");
  expect_error("has no weight");
  attributes().erase("WEIGHTS_0");
  expect_error("JOINTS_0 and WEIGHTS_0");
}

TEST_F(GlbGeometry, MorphWeightsAtRest) {
  json target;
  target["POSITION"] = glb_.accessor<float>({0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 1, 0}, kFloat, "VEC3");
  glb_.primitive()["targets"] = {target};
  expect_bounds({0, 0, 0}, {1, 0, 1});
  glb_.root["meshes"][0]["weights"] = {1};
  expect_bounds({0, 0, 0}, {1, 0, 2});
  glb_.node()["weights"] = {0.5};  // the node's weights win
  expect_bounds({0, 0, 0}, {1, 0, 1.5});
}

TEST_F(GlbGeometry, SparseMorphTarget) {
  // No buffer view: zero apart from the sparse values.
  glb_.root["accessors"].push_back(
      {{"componentType", kFloat},
       {"count", 4},
       {"type", "VEC3"},
       {"sparse",
        {{"count", 1},
         {"indices",
          {{"bufferView", glb_.view(std::string("\x02\x00", 2))}, {"componentType", kShort}}},
         {"values",
          {{"bufferView", glb_.view(std::string("\0\0\0\0\0\0\x80\x3F\0\0\0\0", 12))}}}}}});
  json target;
  target["POSITION"] = glb_.root["accessors"].size() - 1;
  glb_.primitive()["targets"] = {target};
  glb_.root["meshes"][0]["weights"] = {1};
  expect_bounds({0, 0, 0}, {1, 0, 2});
  EXPECT_FLOAT_EQ(load().vertices[3][2].item<float>(), 1);
}

TEST_F(GlbGeometry, SparsePositions) {
  const size_t positions = attributes()["POSITION"];
  const size_t values = glb_.view(std::string("\0\0\0\0\0\0\x40\x40\0\0\0\0", 12));  // (0, 3, 0)
  const auto sparse = [&](const std::string& index, int type, size_t count) {
    glb_.root["accessors"][positions]["sparse"] = {
        {"count", count},
        {"indices", {{"bufferView", glb_.view(index)}, {"componentType", type}}},
        {"values", {{"bufferView", values}}}};
  };
  sparse("\x03", kByte, 1);
  expect_bounds({0, 0, 0}, {1, 0, 3});
  sparse("\x07", kByte, 1);
  expect_error("a sparse index points outside its 4");
  sparse("\x03", kByte, 100);
  expect_error("reaches outside its bufferView");
  sparse("\x03", kByte, 0);
  expect_bounds({0, 0, 0}, {1, 0, 1});
}

TEST_F(GlbGeometry, InstancesAreRepeated) {
  json& instances = glb_.node()["extensions"]["EXT_mesh_gpu_instancing"]["attributes"];
  instances["TRANSLATION"] = glb_.accessor<float>({0, 0, 0, 5, 0, 0}, kFloat, "VEC3");
  // A half turn about glTF's y axis, as normalised bytes, for the second.
  instances["ROTATION"] =
      glb_.accessor<int8_t>({0, 0, 0, 127, 0, 127, 0, 0}, kSignedByte, "VEC4", true);
  instances["SCALE"] = glb_.accessor<float>({1, 1, 1, 2, 3, 1}, kFloat, "VEC3");
  glb_.root["extensionsRequired"] = {"EXT_mesh_gpu_instancing"};
  expect_bounds({0, 0, 0}, {5, 0, 3});
  EXPECT_EQ(load().faces.size(0), 4);
  instances["SCALE"] = glb_.accessor<float>({1, 1, 1}, kFloat, "VEC3");
  expect_error("different counts");
}

TEST_F(GlbGeometry, QuantizedPositions) {
  attributes()["POSITION"] = glb_.accessor<int16_t>(
      {-32767, -32767, 0, 32767, -32767, 0, 32767, 32767, 0, -32768, 32767, 0}, kSignedShort,
      "VEC3", true);
  attributes()["TEXCOORD_0"] =
      glb_.accessor<uint16_t>({0, 65535, 65535, 65535, 65535, 0, 0, 0}, kShort, "VEC2", true);
  glb_.node()["scale"] = {0.5, 0.5, 0.5};
  glb_.node()["translation"] = {0.5, 0.5, 0};
  glb_.root["extensionsRequired"] = {"KHR_mesh_quantization"};
  glb_.use_texture();
  expect_bounds({0, 0, 0}, {1, 0, 1});
  testing::expect_four_colours(load());
  attributes()["POSITION"] =
      glb_.accessor<uint8_t>({0, 0, 0, 4, 0, 0, 4, 4, 0, 0, 4, 0}, kByte, "VEC3");
  glb_.node()["scale"] = {0.25, 0.25, 0.25};
  glb_.node()["translation"] = {0, 0, 0};
  expect_bounds({0, 0, 0}, {1, 0, 1});
}

TEST_F(GlbGeometry, CompressedDataIsRefusedByName) {
  const json uncompressed = glb_.root;
  glb_.primitive()["extensions"]["KHR_draco_mesh_compression"] = {{"bufferView", 0}};
  EXPECT_NO_THROW((void)load());  // the accessors have the data, too
  const size_t positions = attributes()["POSITION"];
  glb_.root["accessors"][positions].erase("bufferView");
  expect_error("KHR_draco_mesh_compression (Draco)");
  glb_.root = uncompressed;
  glb_.save(path_);
  // gltfpack's layout: the uncompressed buffer does not exist.
  glb_.root["bufferViews"][0]["buffer"] = 1;
  glb_.root["buffers"].push_back(
      {{"byteLength", 48}, {"extensions", {{"EXT_meshopt_compression", {{"fallback", true}}}}}});
  write_file_atomic(path_, testing::make_glb(glb_.root, glb_.binary));
  EXPECT_NE(asset_error(path_).find("EXT_meshopt_compression (meshopt)"), std::string::npos)
      << asset_error(path_);
}

TEST_F(GlbGeometry, HiddenNodesAndEmptyScenes) {
  glb_.root["nodes"].push_back({{"mesh", 0}, {"translation", {5, 0, 0}}});
  glb_.root["scenes"][0]["nodes"] = {0, 1};
  glb_.root["nodes"][1]["extensions"]["KHR_node_visibility"]["visible"] = false;
  expect_bounds({0, 0, 0}, {1, 0, 1});
  glb_.root["nodes"][1].erase("extensions");
  glb_.root["scenes"] = json::array();
  expect_bounds({0, 0, 0}, {6, 0, 1});
}

TEST_F(GlbGeometry, TextWithItsFilesBeside) {
  glb_.use_texture();
  const TexturedMesh expected = load();
  glb_.root["buffers"][0]["uri"] = "data%201.bin";
  write_file_atomic(folder_ / "data 1.bin", glb_.binary);
  write_file_atomic(folder_ / "object.gltf", glb_.root.dump(1));
  const TexturedMesh mesh = load_asset(folder_ / "object.gltf");
  EXPECT_TRUE(at::equal(mesh.vertices, expected.vertices));
  EXPECT_TRUE(at::equal(mesh.texture, expected.texture));
  write_file_atomic(folder_ / "data%201.bin", glb_.binary.substr(0, 4));  // this name exists, too
  EXPECT_NE(asset_error(folder_ / "object.gltf").find("is truncated"), std::string::npos);
  write_file_atomic(folder_ / "object.gltf", "{\"asset\":");
  EXPECT_NE(asset_error(folder_ / "object.gltf").find("is not valid JSON"), std::string::npos);
}

TEST_F(GlbGeometry, HugeCountsWithoutData) {
  const size_t positions = attributes()["POSITION"];
  attributes().erase("TEXCOORD_0");
  glb_.root["accessors"][positions].erase("bufferView");
  glb_.root["accessors"][positions]["count"] = 1ULL << 40;
  expect_error("more elements than the file");
  glb_.primitive().erase("indices");
  expect_error("more elements than the file");
}

}  // namespace
}  // namespace tt3d::asset
