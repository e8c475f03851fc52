#include "gltf_material.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>

#include "tt3d/image.h"

namespace tt3d::asset {

using nlohmann::json;

namespace {

Wrap wrap_mode(const GltfFile& file, const json& sampler, const char* key) {
  const size_t mode = file.whole(sampler, key, 10497);
  if (mode == 10497) return Wrap::kRepeat;
  if (mode == 33071) return Wrap::kClamp;
  if (mode == 33648) return Wrap::kMirror;
  file.fail(std::string("a sampler has an unknown ") + key);
}

/// KHR_texture_transform: scale, then rotation, then offset.
void read_transform(const GltfFile& file, const json& info, GltfMaterial& result) {
  const json* transform = file.extension(info, "KHR_texture_transform");
  if (transform == nullptr) return;
  const auto offset = file.numbers<2>(*transform, "offset", {0, 0});
  const auto scale = file.numbers<2>(*transform, "scale", {1, 1});
  const json rotation = transform->value("rotation", json(0));
  if (!rotation.is_number()) file.fail("KHR_texture_transform: rotation must be a number");
  const double c = std::cos(rotation.get<double>()), s = std::sin(rotation.get<double>());
  result.transform = {c * scale[0],  s * scale[1], offset[0],
                      -s * scale[0], c * scale[1], offset[1]};
  if (transform->contains("texCoord")) {
    result.uv_set = "TEXCOORD_" + std::to_string(file.whole(*transform, "texCoord"));
  }
}

/// The image of a texture: a PNG or JPEG, else the WebP of EXT_texture_webp.
size_t image_of(const GltfFile& file, size_t index) {
  const json& texture = file.item("textures", index);
  if (texture.contains("source")) return file.whole(texture, "source");
  if (const json* webp = file.extension(texture, "EXT_texture_webp")) {
    return file.whole(*webp, "source");
  }
  std::string names;
  const json extensions = texture.value("extensions", json::object());
  for (const auto& [name, value] : extensions.items()) {
    names += (names.empty() ? "" : ", ") + name;
  }
  if (names == "KHR_texture_basisu") names += " (KTX2)";
  file.fail("textures[" + std::to_string(index) + "] has no PNG, JPEG or WebP image" +
            (names.empty() ? "" : ", only " + names) + "; export with PNG or JPEG textures");
}

bool is_black(const GltfMaterial& colour) {
  constexpr double kBlack = 1e-3;  // less than one step of an 8-bit sRGB texture
  const bool factor =
      std::all_of(colour.factor.begin(), colour.factor.end(), [](double f) { return f < kBlack; });
  constexpr uint8_t kRounding = 2;  // of JPEG
  return factor || (colour.image.defined() && colour.image.max().item<uint8_t>() <= kRounding);
}

std::array<double, 3> rgb(const std::array<double, 4>& rgba) { return {rgba[0], rgba[1], rgba[2]}; }

}  // namespace

at::Tensor GltfMaterials::read_image(size_t index) {
  at::Tensor& image = images_[index];
  if (image.defined()) return image;
  const std::string name = file_.path().string() + ": images[" + std::to_string(index) + "]";
  image = pictures_.decode(file_.image_bytes(file_.item("images", index)), name);
  return image;
}

void GltfMaterials::read_texture(const json& info, GltfMaterial& result) {
  if (!info.is_object()) file_.fail("a material's texture: expected an object");
  result.uv_set = "TEXCOORD_" + std::to_string(file_.whole(info, "texCoord", 0));
  read_transform(file_, info, result);
  const size_t index = file_.whole(info, "index");
  const json& texture = file_.item("textures", index);
  result.image = read_image(image_of(file_, index));
  if (!texture.contains("sampler")) return;
  const json& sampler = file_.item("samplers", file_.whole(texture, "sampler"));
  result.wrap_u = wrap_mode(file_, sampler, "wrapS");
  result.wrap_v = wrap_mode(file_, sampler, "wrapT");
}

/// KHR_materials_pbrSpecularGlossiness takes precedence over the core's parameters, which are its
/// fallback.
GltfMaterial GltfMaterials::base_colour(const json& material) {
  GltfMaterial result;
  if (const json* glossy = file_.extension(material, "KHR_materials_pbrSpecularGlossiness")) {
    result.factor = rgb(file_.numbers<4>(*glossy, "diffuseFactor", {1, 1, 1, 1}));
    if (glossy->contains("diffuseTexture")) read_texture((*glossy)["diffuseTexture"], result);
    return result;
  }
  const json surface = material.value("pbrMetallicRoughness", json::object());
  if (!surface.is_object()) file_.fail("pbrMetallicRoughness: expected an object");
  result.factor = rgb(file_.numbers<4>(surface, "baseColorFactor", {1, 1, 1, 1}));
  if (surface.contains("baseColorTexture")) read_texture(surface["baseColorTexture"], result);
  return result;
}

GltfMaterial GltfMaterials::emitted(const json& material) {
  GltfMaterial result;
  result.emission = true;
  result.factor = file_.numbers<3>(material, "emissiveFactor", {0, 0, 0});
  if (const json* strength = file_.extension(material, "KHR_materials_emissive_strength")) {
    const json value = strength->value("emissiveStrength", json(1));
    if (!value.is_number()) file_.fail("emissiveStrength: expected a number");
    for (double& f : result.factor) f *= value.get<double>();
  }
  if (material.contains("emissiveTexture")) read_texture(material["emissiveTexture"], result);
  return result;
}

GltfMaterial GltfMaterials::read(size_t index) {
  const json& material = file_.item("materials", index);
  const json name = material.value("name", json());
  const std::string label = name.is_string() ? name.get<std::string>() : std::to_string(index);
  GltfMaterial result = base_colour(material);
  const auto factor = file_.numbers<3>(material, "emissiveFactor", {0, 0, 0});
  const bool emits = factor != std::array{0.0, 0.0, 0.0} &&
                     file_.extension(material, "KHR_materials_unlit") == nullptr;
  if (emits && is_black(result)) {
    result = emitted(material);
    notes_.insert(file_.path().string() + ": material '" + label +
                  "' has a black base colour; its emission is read as its colour");
  } else if (emits) {
    notes_.insert(file_.path().string() + ": material '" + label + "': its emission is ignored");
  }
  result.name = label;
  return result;
}

const GltfMaterial& GltfMaterials::get(std::optional<size_t> index) {
  const auto found = materials_.find(index);
  if (found != materials_.end()) return found->second;
  return materials_.emplace(index, index ? read(*index) : GltfMaterial{}).first->second;
}

SourceMaterial GltfMaterials::source(const GltfMaterial& material,
                                     const std::array<float, 3>& colour) {
  SourceMaterial result;
  result.name = material.name;
  std::array<double, 3> factor{};
  for (size_t c = 0; c < 3; ++c) {
    factor[c] = material.factor[c] * double{colour[c]};
    result.colour[c] = image::linear_to_srgb(static_cast<float>(factor[c]));
  }
  if (material.image.defined()) result.image = pictures_.tint(material.image, factor);
  result.wrap_u = material.wrap_u;
  result.wrap_v = material.wrap_v;
  return result;
}

}  // namespace tt3d::asset
