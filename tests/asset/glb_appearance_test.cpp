#include <gtest/gtest.h>

#include "asset/gltf_builder.h"
#include "support/temporary_folder.h"
#include "tt3d/core.h"
#include "tt3d/image.h"

// Colours of glTF materials: factors, vertex colours, extensions, pictures.

namespace tt3d::asset {
namespace {

using nlohmann::json;
using testing::asset_error;
using testing::expect_colour;
using testing::expect_four_colours;
using testing::GltfBuilder;
using testing::kByte;
using testing::kFloat;
using testing::kShort;

class GlbAppearance : public ::testing::Test {
 protected:
  TexturedMesh load() {
    glb_.save(path_);
    notes_.clear();
    return testing::load_with_notes(path_, notes_);
  }
  void expect_error(const std::string& expected) {
    glb_.save(path_);
    const std::string error = asset_error(path_);
    EXPECT_NE(error.find(expected), std::string::npos) << error << " for " << expected;
  }
  void set_colours(size_t accessor) { glb_.primitive()["attributes"]["COLOR_0"] = accessor; }
  json& surface() { return glb_.material()["pbrMetallicRoughness"]; }

  testing::TemporaryFolder folder_;
  std::filesystem::path path_ = folder_ / "object.glb";
  GltfBuilder glb_;
  std::string notes_;
};

TEST_F(GlbAppearance, OneVertexColourMultipliesTheFactor) {
  surface()["baseColorFactor"] = {0, 1, 0, 1};
  set_colours(glb_.accessor<float>({1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1}, kFloat, "VEC3"));
  expect_colour(load(), {0.3, 0, 0.3}, {0, 255, 0});
  // 0.5 in linear light is sRGB 188.
  set_colours(glb_.accessor<uint16_t>(std::vector<uint16_t>(16, 32768), kShort, "VEC4", true));
  expect_colour(load(), {0.3, 0, 0.3}, {0, 188, 0});
}

TEST_F(GlbAppearance, OneVertexColourMultipliesTheTexture) {
  glb_.use_texture();
  set_colours(glb_.accessor<uint8_t>(std::vector<uint8_t>(16, 255), kByte, "VEC4", true));
  TexturedMesh white = load();
  expect_four_colours(white);
  set_colours(glb_.accessor<uint16_t>(std::vector<uint16_t>(16, 65535), kShort, "VEC4"));
  white = load();
  expect_four_colours(white);
  EXPECT_EQ(white.texture.size(0), 64);  // the texture itself
  surface()["baseColorFactor"] = {1, 0, 1, 1};
  set_colours(glb_.accessor<float>({1, 1, 0, 1, 1, 0, 1, 1, 0, 1, 1, 0}, kFloat, "VEC3"));
  expect_colour(load(), {0.75, 0, 0.25}, {230, 0, 0});
}

TEST_F(GlbAppearance, VertexColoursVaryOverATexture) {
  glb_.use_texture();
  // Black at the left, white at the right; values outside [0,1] are clamped.
  set_colours(glb_.accessor<float>({0, 0, 0, 1, 1, 1, 2, 2, 2, -1, -1, -1}, kFloat, "VEC3"));
  const TexturedMesh mesh = load();
  // Red at x = 0.25: linear 0.716 * 0.25 and 0.013 * 0.25.
  expect_colour(mesh, {0.25, 0, 0.75}, {118, 13, 13}, 4);
  expect_colour(mesh, {0.75, 0, 0.75}, {26, 175, 26}, 4);
  expect_colour(mesh, {0.99, 0, 0.25}, {229, 219, 40}, 4);
  EXPECT_EQ(mesh.vertices.size(0), 4);
}

TEST_F(GlbAppearance, VertexColoursVaryWithoutATexture) {
  surface()["baseColorFactor"] = {1, 0.5, 0, 1};
  set_colours(glb_.accessor<uint8_t>({0, 0, 0, 0, 255, 255, 255, 0, 255, 255, 255, 0, 0, 0, 0, 0},
                                     kByte, "VEC4", true));
  const TexturedMesh mesh = load();
  expect_colour(mesh, {0.5, 0, 0.4}, {188, 137, 0}, 8);
  expect_colour(mesh, {0.001, 0, 0.5}, {0, 0, 0}, 8);
  expect_colour(mesh, {0.999, 0, 0.5}, {255, 188, 0}, 9);
}

TEST_F(GlbAppearance, VertexColoursDoNotSplitTheSurface) {
  // Two triangles with vertices of their own and different colours.
  glb_.primitive().erase("indices");
  json& attributes = glb_.primitive()["attributes"];
  attributes.erase("TEXCOORD_0");
  attributes["POSITION"] =
      glb_.accessor<float>({0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 0, 0, 1, 1, 0, 0, 1, 0}, kFloat, "VEC3");
  set_colours(
      glb_.accessor<float>({1, 0, 0, 1, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 1, 0, 0, 1}, kFloat, "VEC3"));
  const TexturedMesh mesh = load();
  EXPECT_EQ(mesh.vertices.size(0), 4);
  expect_colour(mesh, {0.8, 0, 0.2}, {255, 0, 0});
  expect_colour(mesh, {0.2, 0, 0.8}, {0, 0, 255});
}

TEST_F(GlbAppearance, SpecularGlossiness) {
  json& glossy = glb_.material()["extensions"]["KHR_materials_pbrSpecularGlossiness"];
  glossy["diffuseFactor"] = {0, 0, 1, 1};
  expect_colour(load(), {0.5, 0, 0.5}, {0, 0, 255});
  glossy = json::object();
  glossy["diffuseTexture"]["index"] = 0;
  surface()["baseColorFactor"] = {0, 1, 0, 1};  // the fallback of other readers
  expect_four_colours(load());
  glb_.root["extensionsRequired"] = {"KHR_materials_pbrSpecularGlossiness"};
  expect_four_colours(load());
}

TEST_F(GlbAppearance, EmissionOfABlackMaterial) {
  surface()["baseColorFactor"] = {0, 0, 0, 1};
  glb_.material()["emissiveFactor"] = {1, 1, 1};
  glb_.material()["emissiveTexture"]["index"] = 0;
  set_colours(glb_.accessor<float>(std::vector<float>(12, 0), kFloat, "VEC3"));
  expect_four_colours(load());
  EXPECT_NE(notes_.find("material 'skin' has a black base colour; its emission is read"),
            std::string::npos)
      << notes_;
  glb_.material().erase("emissiveTexture");
  glb_.material()["emissiveFactor"] = {0, 0.25, 0};
  glb_.material()["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"] = 2;
  expect_colour(load(), {0.5, 0, 0.5}, {0, 188, 0});
}

TEST_F(GlbAppearance, OtherEmissionIsIgnored) {
  glb_.use_texture();
  glb_.material()["emissiveFactor"] = {1, 0, 0};
  expect_four_colours(load());
  EXPECT_NE(notes_.find("its emission is ignored"), std::string::npos) << notes_;
  glb_.material()["extensions"]["KHR_materials_unlit"] = json::object();
  expect_four_colours(load());
  EXPECT_EQ(notes_, "");
}

TEST_F(GlbAppearance, UnlitBlackStaysBlack) {
  surface()["baseColorFactor"] = {0, 0, 0, 1};
  glb_.material()["emissiveFactor"] = {1, 1, 1};
  glb_.material()["extensions"]["KHR_materials_unlit"] = json::object();
  expect_colour(load(), {0.5, 0, 0.5}, {0, 0, 0});
}

TEST_F(GlbAppearance, SecondSetOfUvs) {
  glb_.use_texture();
  surface()["baseColorTexture"]["texCoord"] = 1;
  json& attributes = glb_.primitive()["attributes"];
  attributes["TEXCOORD_1"] = attributes["TEXCOORD_0"];
  attributes["TEXCOORD_0"] = glb_.accessor<float>(std::vector<float>(8, 0.9F), kFloat, "VEC2");
  expect_four_colours(load());
  attributes.erase("TEXCOORD_1");
  (void)load();
  EXPECT_NE(notes_.find("no TEXCOORD_1"), std::string::npos) << notes_;
}

TEST_F(GlbAppearance, TransformOverridesTheSetOfUvs) {
  glb_.use_texture();
  json& attributes = glb_.primitive()["attributes"];
  attributes["TEXCOORD_1"] = glb_.accessor<uint8_t>({0, 2, 2, 2, 2, 0, 0, 0}, kByte, "VEC2");
  surface()["baseColorTexture"]["extensions"]["KHR_texture_transform"] = {{"texCoord", 1},
                                                                          {"scale", {0.5, 0.5}}};
  glb_.root["extensionsRequired"] = {"KHR_texture_transform", "KHR_mesh_quantization"};
  expect_four_colours(load());
}

/// [4,4,3] of four_colours as WebP, made by Pillow.
constexpr const char* kWebp =
    "data:image/"
    "webp;base64,UklGRjgAAABXRUJQVlA4TCwAAAAvA8AAAB8gECCU+K9QJEhIQHQj7LDeNiEB0c3yf4Id8vyHlhW4"
    "4aD1Ef2PAQ==";

TEST_F(GlbAppearance, WebpTexture) {
  glb_.use_texture();
  glb_.root["images"].push_back({{"uri", kWebp}});
  glb_.root["textures"] = {{{"extensions", {{"EXT_texture_webp", {{"source", 1}}}}}}};
  expect_four_colours(load());
  glb_.root["extensionsRequired"] = {"EXT_texture_webp"};
  expect_four_colours(load());
  EXPECT_EQ(load().texture.size(0), 4);
}

TEST_F(GlbAppearance, TexturesWithoutAReadablePicture) {
  glb_.use_texture();
  glb_.root["textures"] = {{{"extensions", {{"KHR_texture_basisu", {{"source", 0}}}}}}};
  expect_error("textures[0] has no PNG, JPEG or WebP image, only KHR_texture_basisu (KTX2)");
  glb_.root["textures"] = {{{"sampler", 0}}};
  expect_error("textures[0] has no PNG, JPEG or WebP image");
  glb_.root["textures"] = {{{"source", 0}}};
  glb_.root["images"][0]["bufferView"] = glb_.view("\xABKTX 20\xBB\r\n\x1A\n and more");
  expect_error("is a KTX2 file, neither PNG nor JPEG nor WebP");
}

TEST_F(GlbAppearance, UnknownRequiredExtensionsAreNamed) {
  glb_.root["extensionsRequired"] = {"KHR_texture_basisu"};
  expect_error("KHR_texture_basisu (KTX2 textures), which tt3d does not read");
  glb_.root["extensionsRequired"] = {"ACME_shape"};
  expect_error("needs the glTF extension ACME_shape");
  glb_.root["extensionsRequired"] = {"KHR_materials_clearcoat"};  // changes the reflection only
  EXPECT_NO_THROW((void)load());
}

TEST_F(GlbAppearance, ManyMaterialsShareOnePicture) {
  glb_.use_texture();
  // A second image with the same bytes, and a sampler that does not matter within [0,1].
  glb_.root["images"].push_back(glb_.root["images"][0]);
  glb_.root["samplers"] = {{{"wrapS", 33071}}};
  glb_.root["textures"].push_back({{"source", 1}, {"sampler", 0}});
  for (int i = 1; i < 40; ++i) {
    glb_.root["materials"].push_back(glb_.material());
    glb_.root["materials"].back()["pbrMetallicRoughness"]["baseColorTexture"]["index"] = i % 2;
    json item = glb_.primitive();
    item["material"] = i;
    glb_.root["meshes"][0]["primitives"].push_back(item);
  }
  const TexturedMesh simple = load();
  EXPECT_EQ(simple.texture.size(0), 64);
  EXPECT_EQ(simple.texture.size(1), 64);
  // A plain material forces the textures to be packed.
  glb_.root["materials"].push_back({{"name", "plain"}});
  glb_.root["nodes"] = {{{"mesh", 0}}, {{"mesh", 1}, {"translation", {5, 0, 0}}}};
  glb_.root["scenes"][0]["nodes"] = {0, 1};
  json plain = glb_.primitive();
  plain["material"] = 40;
  glb_.root["meshes"].push_back({{"primitives", {plain}}});
  const TexturedMesh packed = load();
  EXPECT_LE(packed.texture.size(0) * packed.texture.size(1), 100 * 100);
  expect_four_colours(packed);
  expect_colour(packed, {5.5, 0, 0.5}, {255, 255, 255});
}

TEST_F(GlbAppearance, DifferentFactorsOnOnePicture) {
  glb_.use_texture();
  glb_.root["materials"].push_back(glb_.material());
  glb_.root["materials"][1]["pbrMetallicRoughness"]["baseColorFactor"] = {0, 0, 0, 1};
  json second = glb_.root["meshes"][0];
  second["primitives"][0]["material"] = 1;
  glb_.root["meshes"].push_back(second);
  glb_.root["nodes"] = {{{"mesh", 0}}, {{"mesh", 1}, {"translation", {5, 0, 0}}}};
  glb_.root["scenes"][0]["nodes"] = {0, 1};
  const TexturedMesh mesh = load();
  expect_four_colours(mesh);
  expect_colour(mesh, {5.25, 0, 0.75}, {0, 0, 0});
}

}  // namespace
}  // namespace tt3d::asset
