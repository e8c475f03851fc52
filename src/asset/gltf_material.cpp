#include <ATen/ATen.h>

#include <cmath>

#include "gltf_file.h"
#include "tt3d/image.h"

namespace tt3d::asset {

using nlohmann::json;

namespace {

/// Multiplies a picture by a factor given in linear light.
at::Tensor tint(const at::Tensor& image, const std::array<double, 4>& factor) {
  if (factor[0] == 1 && factor[1] == 1 && factor[2] == 1) return image;
  at::Tensor result = image.clone();
  uint8_t* pixels = result.data_ptr<uint8_t>();
  for (int c = 0; c < 3; ++c) {
    uint8_t table[256];
    for (int i = 0; i < 256; ++i) {
      const float linear = image::srgb_to_linear(static_cast<float>(i) / 255.F);
      const float tinted = image::linear_to_srgb(linear * static_cast<float>(factor[c]));
      table[i] = static_cast<uint8_t>(std::lround(tinted * 255.F));
    }
    for (int64_t i = c; i < result.numel(); i += 3) pixels[i] = table[pixels[i]];
  }
  return result;
}

Wrap wrap_mode(const GltfFile& file, const json& sampler, const char* key) {
  const size_t mode = file.whole(sampler, key, 10497);
  if (mode == 10497) return Wrap::kRepeat;
  if (mode == 33071) return Wrap::kClamp;
  if (mode == 33648) return Wrap::kMirror;
  file.fail(std::string("a sampler has an unknown ") + key);
}

/// KHR_texture_transform: scale, then rotation, then offset.
void read_transform(const GltfFile& file, const json& info, GltfMaterial& result) {
  const json extensions = info.value("extensions", json::object());
  if (!extensions.is_object() || !extensions.contains("KHR_texture_transform")) return;
  const json& transform = extensions["KHR_texture_transform"];
  if (!transform.is_object()) file.fail("KHR_texture_transform: expected an object");
  const auto offset = file.numbers<2>(transform, "offset", {0, 0});
  const auto scale = file.numbers<2>(transform, "scale", {1, 1});
  const json rotation = transform.value("rotation", json(0));
  if (!rotation.is_number()) file.fail("KHR_texture_transform: rotation must be a number");
  const double c = std::cos(rotation.get<double>()), s = std::sin(rotation.get<double>());
  result.transform = {c * scale[0],  s * scale[1], offset[0],
                      -s * scale[0], c * scale[1], offset[1]};
  if (transform.contains("texCoord")) {
    result.uv_set = "TEXCOORD_" + std::to_string(file.whole(transform, "texCoord"));
  }
}

void read_texture(const GltfFile& file, const json& info, const std::array<double, 4>& factor,
                  GltfMaterial& result) {
  if (!info.is_object()) file.fail("baseColorTexture: expected an object");
  result.uv_set = "TEXCOORD_" + std::to_string(file.whole(info, "texCoord", 0));
  read_transform(file, info, result);
  const json& texture = file.item("textures", file.whole(info, "index"));
  const size_t source = file.whole(texture, "source");
  const std::string name = file.path().string() + ": images[" + std::to_string(source) + "]";
  result.material.image =
      tint(rgb_image(file.image_bytes(file.item("images", source)), name), factor);
  if (!texture.contains("sampler")) return;
  const json& sampler = file.item("samplers", file.whole(texture, "sampler"));
  result.material.wrap_u = wrap_mode(file, sampler, "wrapS");
  result.material.wrap_v = wrap_mode(file, sampler, "wrapT");
}

}  // namespace

GltfMaterial read_gltf_material(const GltfFile& file, size_t index) {
  const json& material = file.item("materials", index);
  GltfMaterial result;
  const json name = material.value("name", json());
  result.material.name = name.is_string() ? name.get<std::string>() : std::to_string(index);
  const json surface = material.value("pbrMetallicRoughness", json::object());
  if (!surface.is_object()) file.fail("pbrMetallicRoughness: expected an object");
  const auto factor = file.numbers<4>(surface, "baseColorFactor", {1, 1, 1, 1});
  for (size_t c = 0; c < 3; ++c) {
    result.material.colour[c] = image::linear_to_srgb(static_cast<float>(factor[c]));
  }
  if (surface.contains("baseColorTexture")) {
    read_texture(file, surface["baseColorTexture"], factor, result);
  }
  return result;
}

}  // namespace tt3d::asset
