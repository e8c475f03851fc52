#include <cstring>

#include "gltf_file.h"

namespace tt3d::asset {

using nlohmann::json;

namespace {

/// A component type: its size in bytes and the factor of its normalised form.
struct Component {
  size_t size = 0;
  double scale = 1;
};

Component component(size_t type) {
  switch (type) {
    case 5120:
      return {1, 1 / 127.0};
    case 5121:
      return {1, 1 / 255.0};
    case 5122:
      return {2, 1 / 32767.0};
    case 5123:
      return {2, 1 / 65535.0};
    case 5125:
      return {4, 1 / 4294967295.0};
    case 5126:
      return {4, 1};
    default:
      return {};
  }
}

template <typename T>
double read_as(const char* data) {
  T value;
  std::memcpy(&value, data, sizeof value);
  return static_cast<double>(value);
}

double read_component(size_t type, const char* data) {
  switch (type) {
    case 5120:
      return read_as<int8_t>(data);
    case 5121:
      return read_as<uint8_t>(data);
    case 5122:
      return read_as<int16_t>(data);
    case 5123:
      return read_as<uint16_t>(data);
    case 5125:
      return read_as<uint32_t>(data);
    default:
      return read_as<float>(data);
  }
}

size_t type_width(const std::string& type) {
  if (type == "SCALAR") return 1;
  return type.starts_with("VEC") && type.size() == 4 ? static_cast<size_t>(type[3] - '0') : 0;
}

}  // namespace

std::string_view GltfFile::view(size_t index, size_t& stride) const {
  const json& view = item("bufferViews", index);
  const size_t buffer = whole(view, "buffer");
  if (buffer >= buffers_.size()) fail("a bufferView names a buffer that does not exist");
  const size_t offset = whole(view, "byteOffset", 0);
  const size_t size = whole(view, "byteLength");
  stride = whole(view, "byteStride", 0);
  const std::string& bytes = buffers_[buffer];
  if (offset > bytes.size() || size > bytes.size() - offset) {
    fail("bufferViews[" + std::to_string(index) + "] lies outside its buffer");
  }
  return std::string_view(bytes).substr(offset, size);
}

AccessorValues GltfFile::accessor(size_t index, const std::set<std::string>& types) const {
  const std::string where = "accessors[" + std::to_string(index) + "]";
  const json& accessor = item("accessors", index);
  const json type = accessor.value("type", json());
  if (!type.is_string() || !types.contains(type.get<std::string>())) {
    fail(where + ": has the type " + type.dump() + ", expected " + *types.begin());
  }
  if (accessor.contains("sparse") || !accessor.contains("bufferView")) {
    fail(where + ": sparse accessors are not supported; export without them");
  }
  const size_t component_type = whole(accessor, "componentType");
  const Component part = component(component_type);
  if (part.size == 0) fail(where + ": has an unknown component type");
  AccessorValues result;
  result.count = whole(accessor, "count");
  result.width = type_width(type.get<std::string>());

  // The last element must end inside the view; the divisions avoid overflow.
  size_t stride = 0;
  const std::string_view bytes = view(whole(accessor, "bufferView"), stride);
  const size_t offset = whole(accessor, "byteOffset", 0);
  const size_t element = part.size * result.width;
  if (stride == 0) stride = element;
  const bool fits =
      offset <= bytes.size() && element <= bytes.size() - offset &&
      (result.count == 0 || result.count - 1 <= (bytes.size() - offset - element) / stride);
  if (!fits) fail(where + ": reaches outside its bufferView");
  const json normalized = accessor.value("normalized", json(false));
  const double scale = normalized.is_boolean() && normalized.get<bool>() ? part.scale : 1;
  result.values.reserve(result.count * result.width);
  for (size_t i = 0; i < result.count; ++i) {
    for (size_t c = 0; c < result.width; ++c) {
      const char* data = bytes.data() + offset + i * stride + c * part.size;
      result.values.push_back(scale * read_component(component_type, data));
    }
  }
  return result;
}

}  // namespace tt3d::asset
