#include <algorithm>
#include <cstring>
#include <numeric>

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
  if (type == "MAT4") return 16;
  return type.starts_with("VEC") && type.size() == 4 ? static_cast<size_t>(type[3] - '0') : 0;
}

}  // namespace

std::string_view GltfFile::view(size_t index, size_t& stride) const {
  const std::string where = "bufferViews[" + std::to_string(index) + "]";
  const json& view = item("bufferViews", index);
  const size_t buffer = whole(view, "buffer");
  if (buffer >= buffers_.size()) fail("a bufferView names a buffer that does not exist");
  if (!missing_[buffer].empty()) {
    fail(where + " is compressed with " + missing_[buffer] +
         " (meshopt), which tt3d does not read; export without compression");
  }
  const size_t offset = whole(view, "byteOffset", 0);
  const size_t size = whole(view, "byteLength");
  stride = whole(view, "byteStride", 0);
  const std::string& bytes = buffers_[buffer];
  if (offset > bytes.size() || size > bytes.size() - offset) {
    fail(where + " lies outside its buffer");
  }
  return std::string_view(bytes).substr(offset, size);
}

std::vector<double> GltfFile::elements(const json& place, const Layout& layout) const {
  const Component part = component(layout.component_type);
  if (part.size == 0) fail(layout.where + ": has an unknown component type");
  size_t stride = 0;
  const std::string_view bytes = view(whole(place, "bufferView"), stride);
  const size_t offset = whole(place, "byteOffset", 0);
  const size_t element = part.size * layout.width;
  if (stride == 0) stride = element;
  // The last element must end inside the view; the divisions avoid overflow.
  const bool fits =
      offset <= bytes.size() && element <= bytes.size() - offset &&
      (layout.count == 0 || layout.count - 1 <= (bytes.size() - offset - element) / stride);
  if (!fits) fail(layout.where + ": reaches outside its bufferView");
  std::vector<double> values;
  values.reserve(layout.count * layout.width);
  for (size_t i = 0; i < layout.count; ++i) {
    for (size_t c = 0; c < layout.width; ++c) {
      const char* data = bytes.data() + offset + i * stride + c * part.size;
      const double value = read_component(layout.component_type, data);
      // A normalised signed integer has two codes for -1.
      values.push_back(layout.normalized ? std::max(part.scale * value, -1.0) : value);
    }
  }
  return values;
}

/// Replaces the elements that a sparse accessor lists.
void GltfFile::apply_sparse(const json& sparse, const Layout& layout,
                            std::vector<double>& values) const {
  const json at = sparse.is_object() ? sparse.value("indices", json()) : json();
  const json with = sparse.is_object() ? sparse.value("values", json()) : json();
  if (!at.is_object() || !with.is_object()) {
    fail(layout.where + ": its sparse part needs indices and values");
  }
  Layout rows = layout;
  rows.count = whole(sparse, "count");
  const std::vector<double> replaced = elements(with, rows);
  const std::vector<double> where =
      elements(at, {layout.where, whole(at, "componentType"), 1, rows.count, false});
  for (size_t i = 0; i < rows.count; ++i) {
    if (!(where[i] >= 0) || where[i] >= static_cast<double>(layout.count)) {
      fail(layout.where + ": a sparse index points outside its " + std::to_string(layout.count) +
           " elements");
    }
    const auto row = static_cast<ptrdiff_t>(where[i]),
               width = std::ssize(replaced) / static_cast<ptrdiff_t>(rows.count);
    std::copy_n(replaced.begin() + static_cast<ptrdiff_t>(i) * width, width,
                values.begin() + row * width);
  }
}

AccessorValues GltfFile::accessor(size_t index, const std::set<std::string>& types) const {
  const std::string where = "accessors[" + std::to_string(index) + "]";
  const json& accessor = item("accessors", index);
  const json type = accessor.value("type", json());
  if (!type.is_string() || !types.contains(type.get<std::string>())) {
    fail(where + ": has the type " + type.dump() + ", expected " + *types.begin());
  }
  const json normalized = accessor.value("normalized", json(false));
  const Layout layout = {where, whole(accessor, "componentType"),
                         type_width(type.get<std::string>()), whole(accessor, "count"),
                         normalized.is_boolean() && normalized.get<bool>()};
  AccessorValues result{layout.count, layout.width, {}};
  if (accessor.contains("bufferView")) {
    result.values = elements(accessor, layout);
  } else {
    const size_t bytes =
        std::accumulate(buffers_.begin(), buffers_.end(), size_t{0},
                        [](size_t sum, const std::string& buffer) { return sum + buffer.size(); });
    if (layout.count > bytes) fail(where + ": has no bufferView and more elements than the file");
    result.values.assign(layout.count * layout.width, 0);
  }
  if (accessor.contains("sparse")) apply_sparse(accessor["sparse"], layout, result.values);
  return result;
}

}  // namespace tt3d::asset
