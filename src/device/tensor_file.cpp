#include "tt3d/tensor_file.h"

#include <ATen/ATen.h>

#include <algorithm>
#include <cstring>
#include <fstream>
#include <nlohmann/json.hpp>

#include "tt3d/core.h"

namespace tt3d {
namespace {

using nlohmann::json;

struct Dtype {
  const char* name;
  at::ScalarType type;
};
constexpr Dtype kDtypes[] = {{"F32", at::kFloat},
                             {"F64", at::kDouble},
                             {"I32", at::kInt},
                             {"I64", at::kLong},
                             {"U8", at::kByte}};
constexpr uint64_t kMaxHeader = uint64_t{64} << 20;
constexpr uint64_t kMaxElements = uint64_t{1} << 40;

std::string dtype_name(at::ScalarType type) {
  for (const Dtype& d : kDtypes) {
    if (d.type == type) return d.name;
  }
  throw Error("save_tensors: unsupported dtype " + std::string(at::toString(type)));
}

at::ScalarType dtype_of(const std::string& name, const std::filesystem::path& path) {
  for (const Dtype& d : kDtypes) {
    if (name == d.name) return d.type;
  }
  throw InputError(path, "unknown dtype '" + name + "', expected F32, F64, I32, I64 or U8");
}

/// Checks an entry of the header against the data section and copies its tensor out.
at::Tensor read_entry(const std::string& name, const json& entry, std::string_view data,
                      const std::filesystem::path& path) {
  const at::ScalarType dtype = dtype_of(entry.at("dtype").get<std::string>(), path);
  const auto shape = entry.at("shape").get<std::vector<int64_t>>();
  const auto offsets = entry.at("data_offsets").get<std::vector<uint64_t>>();
  uint64_t bytes = at::elementSize(dtype);
  uint64_t extent = 1;  // product of the non-zero sizes; the strides are computed from it
  for (const int64_t n : shape) {
    if (n < 0 || static_cast<uint64_t>(n) > kMaxElements / extent ||
        (n > 0 && bytes > data.size() / static_cast<uint64_t>(n))) {
      throw InputError(path, "tensor '" + name + "' is larger than the file");
    }
    bytes *= static_cast<uint64_t>(n);
    extent *= std::max<uint64_t>(1, static_cast<uint64_t>(n));
  }
  if (offsets.size() != 2 || offsets[0] > offsets[1] || offsets[1] > data.size() ||
      offsets[1] - offsets[0] != bytes) {
    throw InputError(path, "tensor '" + name + "': offsets do not fit its shape and the file");
  }
  at::Tensor tensor = at::empty(shape, dtype);
  if (bytes > 0) std::memcpy(tensor.mutable_data_ptr(), data.data() + offsets[0], bytes);
  return tensor;
}

}  // namespace

at::Tensor TensorFile::get(const std::string& name, at::IntArrayRef shape,
                           at::ScalarType dtype) const {
  const auto found = tensors.find(name);
  if (found == tensors.end()) throw InputError(path, "has no tensor '" + name + "'");
  const at::Tensor& t = found->second;
  const bool fits =
      std::equal(t.sizes().begin(), t.sizes().end(), shape.begin(), shape.end(),
                 [](int64_t size, int64_t wanted) { return wanted < 0 || size == wanted; });
  if (!fits || t.scalar_type() != dtype) {
    std::ostringstream text;
    text << "tensor '" << name << "' is " << at::toString(t.scalar_type()) << " " << t.sizes()
         << ", expected " << at::toString(dtype) << " " << shape;
    throw InputError(path, text.str());
  }
  return t;
}

void save_tensors(const std::filesystem::path& path,
                  const std::vector<std::pair<std::string, at::Tensor>>& tensors,
                  const std::map<std::string, std::string>& metadata) {
  json header = {{"__metadata__", metadata}};
  std::vector<at::Tensor> dense;
  uint64_t offset = 0;
  for (const auto& [name, tensor] : tensors) {
    dense.push_back(tensor.detach().cpu().contiguous());
    const uint64_t end = offset + dense.back().nbytes();
    header[name] = {{"dtype", dtype_name(tensor.scalar_type())},
                    {"shape", std::vector<int64_t>(tensor.sizes().begin(), tensor.sizes().end())},
                    {"data_offsets", {offset, end}}};
    offset = end;
  }
  std::string text = header.dump();
  text.resize((text.size() + 7) / 8 * 8, ' ');
  write_file_atomic(path, [&](const std::filesystem::path& temporary) {
    std::ofstream out(temporary, std::ios::binary | std::ios::trunc);
    const auto size = static_cast<uint64_t>(text.size());
    out.write(reinterpret_cast<const char*>(&size), sizeof size);
    out.write(text.data(), static_cast<std::streamsize>(text.size()));
    for (const at::Tensor& t : dense) {
      out.write(static_cast<const char*>(t.const_data_ptr()),
                static_cast<std::streamsize>(t.nbytes()));
    }
    out.close();
    if (!out) throw ResourceError(path.string() + ": cannot write: " + std::strerror(errno));
  });
}

TensorFile load_tensors(const std::filesystem::path& path) {
  const std::string bytes = read_file(path);
  uint64_t header_size = 0;
  if (bytes.size() < sizeof header_size) throw InputError(path, "is too short for a tensor file");
  std::memcpy(&header_size, bytes.data(), sizeof header_size);
  if (header_size > kMaxHeader || header_size > bytes.size() - sizeof header_size) {
    throw InputError(path, "is not a safetensors file, or is truncated");
  }
  const std::string_view data =
      std::string_view(bytes).substr(sizeof header_size + static_cast<size_t>(header_size));
  TensorFile file;
  file.path = path;
  try {
    const json header = json::parse(bytes.data() + sizeof header_size,
                                    bytes.data() + sizeof header_size + header_size);
    for (const auto& [name, entry] : header.items()) {
      if (name == "__metadata__")
        file.metadata = entry.get<std::map<std::string, std::string>>();
      else
        file.tensors[name] = read_entry(name, entry, data, path);
    }
  } catch (const json::exception& error) {
    throw InputError(path, std::string("has a malformed header: ") + error.what());
  }
  return file;
}

}  // namespace tt3d
