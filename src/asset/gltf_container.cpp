#include <cstring>

#include "gltf_file.h"

namespace tt3d::asset {

using nlohmann::json;

namespace {

constexpr uint32_t kMagic = 0x46546C67;        // "glTF"
constexpr uint32_t kJsonChunk = 0x4E4F534A;    // "JSON"
constexpr uint32_t kBinaryChunk = 0x004E4942;  // "BIN"

const std::set<std::string>& read_extensions() {
  static const std::set<std::string> names = {"KHR_materials_unlit",
                                              "KHR_texture_transform",
                                              "KHR_mesh_quantization",
                                              "KHR_materials_pbrSpecularGlossiness",
                                              "KHR_materials_emissive_strength",
                                              "KHR_node_visibility",
                                              "EXT_mesh_gpu_instancing",
                                              "EXT_texture_webp"};
  return names;
}

/// Extensions that change neither the shape nor the base colour, only what tt3d ignores: light,
/// reflection, transparency, animation and alternative materials.
const std::set<std::string>& light_extensions() {
  static const std::set<std::string> names = {
      "KHR_lights_punctual",      "KHR_materials_anisotropy", "KHR_materials_clearcoat",
      "KHR_materials_dispersion", "KHR_materials_ior",        "KHR_materials_iridescence",
      "KHR_materials_sheen",      "KHR_materials_specular",   "KHR_materials_transmission",
      "KHR_materials_volume",     "KHR_materials_variants",   "KHR_materials_diffuse_transmission",
      "KHR_animation_pointer",    "KHR_xmp_json_ld",          "EXT_lights_image_based"};
  return names;
}

/// Extensions that users meet, in plain words.
const std::map<std::string, std::string>& refused_extensions() {
  static const std::map<std::string, std::string> names = {
      {"KHR_draco_mesh_compression", "Draco compression"},
      {"EXT_meshopt_compression", "meshopt compression"},
      {"KHR_meshopt_compression", "meshopt compression"},
      {"KHR_texture_basisu", "KTX2 textures"},
      {"EXT_texture_avif", "AVIF textures"},
      {"MSFT_texture_dds", "DDS textures"},
      {"KHR_gaussian_splatting", "Gaussian splats"}};
  return names;
}

uint32_t u32_at(const std::string& bytes, size_t offset) {
  uint32_t value = 0;
  std::memcpy(&value, bytes.data() + offset, sizeof value);
  return value;
}

int base64_digit(char c) {
  if (c >= 'A' && c <= 'Z') return c - 'A';
  if (c >= 'a' && c <= 'z') return c - 'a' + 26;
  if (c >= '0' && c <= '9') return c - '0' + 52;
  return c == '+' ? 62 : c == '/' ? 63 : -1;
}

/// Decodes base64; false if a character is invalid.
bool decode_base64(std::string_view text, std::string& bytes) {
  uint32_t bits = 0;
  int count = 0;
  for (const char c : text.substr(0, text.find_last_not_of('=') + 1)) {
    const int digit = base64_digit(c);
    if (digit < 0) return false;
    bits = (bits << 6) | static_cast<uint32_t>(digit);
    count += 6;
    if (count < 8) continue;
    count -= 8;
    bytes += static_cast<char>((bits >> count) & 0xFF);
  }
  return true;
}

/// Decodes the percent escapes of a URI, e.g. "%20".
std::string decode_percent(const std::string& uri) {
  std::string text;
  for (size_t i = 0; i < uri.size(); ++i) {
    const bool escaped = uri[i] == '%' && i + 2 < uri.size() && std::isxdigit(uri[i + 1]) != 0 &&
                         std::isxdigit(uri[i + 2]) != 0;
    text += escaped ? static_cast<char>(std::stoi(uri.substr(i + 1, 2), nullptr, 16)) : uri[i];
    if (escaped) i += 2;
  }
  return text;
}

/// The extension whose decoder would fill this buffer, or "".
std::string meshopt_fallback(const GltfFile& file, const json& buffer) {
  for (const char* name : {"EXT_meshopt_compression", "KHR_meshopt_compression"}) {
    if (file.extension(buffer, name) != nullptr) return name;
  }
  return "";
}

}  // namespace

GltfFile::GltfFile(const std::filesystem::path& path) : path_(path) {
  const std::string bytes = read_part(path, files_);
  const bool is_text = bytes.find_first_of('{') < bytes.find("glTF");
  is_text ? void(root_ = json::parse(bytes, nullptr, false)) : split_chunks(bytes);
  if (!root_.is_object()) fail(is_text ? "is not valid JSON" : "its JSON chunk is not valid JSON");
  const auto asset = root_.find("asset");
  if (asset == root_.end() || !asset->is_object() || !asset->value("version", json()).is_string() ||
      !(*asset)["version"].get<std::string>().starts_with("2.")) {
    fail("expected glTF version 2");
  }
  check_extensions();
  load_buffers();
}

void GltfFile::check_extensions() const {
  const json required = root_.value("extensionsRequired", json::array());
  for (const json& extension : required) {
    const std::string name = extension.is_string() ? extension.get<std::string>() : "";
    if (read_extensions().contains(name) || light_extensions().contains(name)) continue;
    const auto known = refused_extensions().find(name);
    fail("needs the glTF extension " + (name.empty() ? extension.dump() : name) +
         (known == refused_extensions().end() ? "" : " (" + known->second + ")") +
         ", which tt3d does not read; export the asset without it");
  }
}

void GltfFile::fail(const std::string& what) const { throw InputError(path_, what); }

void GltfFile::split_chunks(const std::string& bytes) {
  if (bytes.size() < 20 || u32_at(bytes, 0) != kMagic) fail("is not a GLB file");
  if (u32_at(bytes, 4) != 2) fail("expected GLB version 2");
  const size_t length = u32_at(bytes, 8);
  if (length > bytes.size() || length < 20) fail("is truncated");
  size_t position = 12;
  for (int chunk = 0; position + 8 <= length; ++chunk) {
    const size_t size = u32_at(bytes, position);
    const uint32_t type = u32_at(bytes, position + 4);
    position += 8;
    if (size > length - position) fail("is truncated: a chunk is longer than the file");
    if (chunk == 0 && type != kJsonChunk) fail("its first chunk is not JSON");
    if (chunk == 0) {
      root_ = json::parse(std::string_view(bytes).substr(position, size), nullptr, false);
    } else if (type == kBinaryChunk && binary_.empty()) {
      binary_ = bytes.substr(position, size);
    }
    position += size;
  }
}

void GltfFile::load_buffers() {
  const json buffers = root_.value("buffers", json::array());
  if (!buffers.is_array()) fail("buffers: expected an array");
  for (const json& buffer : buffers) {
    if (!buffer.is_object()) fail("buffers: expected objects");
    const size_t size = whole(buffer, "byteLength");
    const json uri = buffer.value("uri", json());
    missing_.push_back(uri.is_string() ? "" : meshopt_fallback(*this, buffer));
    if (!missing_.back().empty()) {
      buffers_.emplace_back();
      continue;
    }
    std::string bytes = uri.is_string() ? uri_bytes(uri.get<std::string>()) : binary_;
    if (!uri.is_string() && !buffers_.empty()) fail("only its first buffer can be the BIN chunk");
    if (size > bytes.size()) fail("is truncated: a buffer is shorter than its byteLength");
    bytes.resize(size);
    buffers_.push_back(std::move(bytes));
  }
}

std::string GltfFile::uri_bytes(const std::string& uri) const {
  if (!uri.starts_with("data:")) {
    // Some exporters do not escape the characters of a file name.
    const auto unescaped = find_reference(path_, uri);
    return read_part(unescaped ? *unescaped : resolve_reference(path_, decode_percent(uri)),
                     files_);
  }
  constexpr std::string_view kMarker = ";base64,";
  const size_t marker = uri.find(kMarker);
  std::string bytes;
  if (marker == std::string::npos ||
      !decode_base64(std::string_view(uri).substr(marker + kMarker.size()), bytes)) {
    fail("contains a data URI that is not base64");
  }
  return bytes;
}

std::string GltfFile::image_bytes(const json& image) const {
  const auto uri = image.find("uri");
  if (uri != image.end() && uri->is_string()) return uri_bytes(uri->get<std::string>());
  size_t stride = 0;
  return std::string(view(whole(image, "bufferView"), stride));
}

const json& GltfFile::item(const char* name, size_t index) const {
  const auto array = root_.find(name);
  if (array == root_.end() || !array->is_array() || index >= array->size() ||
      !(*array)[index].is_object()) {
    fail("refers to " + std::string(name) + "[" + std::to_string(index) +
         "], which does not exist");
  }
  return (*array)[index];
}

std::vector<size_t> GltfFile::indices(const json& object, const char* key) const {
  std::vector<size_t> result;
  const json array = object.value(key, json::array());
  if (!array.is_array()) fail(std::string(key) + ": expected an array");
  for (const json& value : array) {
    if (!value.is_number_unsigned()) fail(std::string(key) + ": expected indices");
    result.push_back(value.get<size_t>());
  }
  return result;
}

const json* GltfFile::extension(const json& object, const char* name) const {
  const auto all = object.find("extensions");
  if (all == object.end() || !all->is_object()) return nullptr;
  const auto found = all->find(name);
  if (found == all->end()) return nullptr;
  if (!found->is_object()) fail(std::string(name) + ": expected an object");
  return &*found;
}

size_t GltfFile::whole(const json& object, const char* key, int64_t fallback) const {
  const auto found = object.find(key);
  if (found == object.end() && fallback >= 0) return static_cast<size_t>(fallback);
  if (found == object.end() || !found->is_number_unsigned()) {
    fail(std::string(key) + ": expected a whole number of at least 0");
  }
  return found->get<size_t>();
}

}  // namespace tt3d::asset
