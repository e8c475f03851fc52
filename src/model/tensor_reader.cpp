#include "tensor_reader.h"

#include <ATen/ATen.h>
#include <fmt/format.h>

#include "json_numbers.h"
#include "malformed.h"

namespace tt3d::model {
namespace {

using Json = nlohmann::json;

constexpr int64_t kStridedLayout = 7;
/// The alignment of torch's own allocations, and of weights in the archives that torch writes.
constexpr uintptr_t kAlignment = 64;

/// A uint8 tensor over a part of a mapped file, which it keeps alive. When the last tensor over the
/// part is freed (e.g. after folding), the memory is released too.
at::Tensor view_of_file(const std::shared_ptr<const MappedFile>& file, std::string_view part) {
  // Nothing writes through it: the graph is checked for writes, and the mapping is read-only.
  return at::from_blob(
      const_cast<char*>(part.data()), {static_cast<int64_t>(part.size())},
      [file, part](void*) { file->release(part); }, at::TensorOptions(at::kByte));
}

/// A folder of payloads. Each file is read once, even if several tensors view it.
class PayloadFolder {
 public:
  PayloadFolder(const Archive& archive, std::string folder, const ModelLimits& limits)
      : archive_(archive), folder_(std::move(folder)), limits_(limits) {}

  /// The bytes of a file as a uint8 tensor.
  const at::Tensor& bytes(const std::string& file) {
    const auto known = files_.find(file);
    if (known != files_.end()) return known->second;
    if (file.empty() || file.find('/') != std::string::npos || file == "..") {
      throw Malformed(fmt::format("weights file '{}' is not a plain file name", file));
    }
    const std::string name = folder_ + file;
    const int64_t size = archive_.size(name);
    if (size > limits_.tensor_bytes) {
      throw Malformed(
          fmt::format("entry '{}' has {} bytes, more than tensor_bytes of the model "
                      "limits ({})",
                      name, size, limits_.tensor_bytes));
    }
    return files_.emplace(file, load(name, size)).first->second;
  }

 private:
  /// Returns the mapped bytes if the archive stores them plainly, else a copy.
  at::Tensor load(const std::string& name, int64_t size) const {
    const auto data = archive_.mapped(name);
    if (data && reinterpret_cast<uintptr_t>(data->data()) % kAlignment == 0) {
      return view_of_file(archive_.file(), *data);
    }
    at::Tensor copy = at::empty({size}, at::kByte);
    archive_.read(name, copy.data_ptr());
    return copy;
  }

  const Archive& archive_;
  std::string folder_;
  const ModelLimits& limits_;
  std::map<std::string, at::Tensor> files_;
};

std::vector<int64_t> read_ints(const Json& list, const char* what) {
  if (!list.is_array() || list.size() > 16) {
    throw Malformed(fmt::format("{} is not a short list", what));
  }
  std::vector<int64_t> values;
  for (const Json& item : list) {
    values.push_back(read_integer(item.at("as_int")));
    if (values.back() < 0) throw Malformed(fmt::format("{} has a negative entry", what));
  }
  return values;
}

/// Checks that sizes, strides and offset (in elements) stay inside `available` elements.
void check_extent(const std::vector<int64_t>& sizes, const std::vector<int64_t>& strides,
                  int64_t offset, int64_t available) {
  if (sizes.size() != strides.size()) throw Malformed("sizes and strides disagree in length");
  int64_t last = offset;
  bool empty = false;
  for (size_t i = 0; i < sizes.size(); ++i) {
    int64_t reach = 0;
    if (sizes[i] == 0) empty = true;
    if (__builtin_mul_overflow(std::max<int64_t>(sizes[i] - 1, 0), strides[i], &reach) ||
        __builtin_add_overflow(last, reach, &last)) {
      throw Malformed("sizes and strides overflow");
    }
  }
  if (offset < 0 || (!empty && last >= available)) {
    throw Malformed(
        fmt::format("sizes and strides reach element {} of a file of {}", last, available));
  }
}

/// Strides of zero repeat elements; a copy of such a view must stay within `limit` bytes too.
void check_bytes(const std::vector<int64_t>& sizes, int64_t element_bytes, int64_t limit) {
  int64_t bytes = element_bytes;
  for (const int64_t size : sizes) {
    if (__builtin_mul_overflow(bytes, size, &bytes)) throw Malformed("sizes overflow");
  }
  if (bytes > limit) {
    throw Malformed(
        fmt::format("has {} bytes, more than tensor_bytes of the model limits ({})", bytes, limit));
  }
}

at::Tensor view_of(const at::Tensor& bytes, const Json& meta, const ModelLimits& limits) {
  if (read_integer(meta.at("layout")) != kStridedLayout) {
    throw Malformed("is not a plain strided tensor");
  }
  const at::ScalarType type = scalar_type_of(read_integer(meta.at("dtype")));
  const auto sizes = read_ints(meta.at("sizes"), "sizes");
  const auto strides = read_ints(meta.at("strides"), "strides");
  const int64_t offset = read_integer(meta.at("storage_offset").at("as_int"));
  const auto element_bytes = static_cast<int64_t>(at::elementSize(type));
  const int64_t available = bytes.numel() / element_bytes;
  check_extent(sizes, strides, offset, available);
  check_bytes(sizes, element_bytes, limits.tensor_bytes);
  if (bytes.numel() == 0) return at::empty(sizes, type);
  // A bool must be 0 or 1 in memory, whatever the file contains.
  const at::Tensor elements =
      type == at::kBool ? bytes.ne(0) : bytes.narrow(0, 0, available * element_bytes).view(type);
  return elements.as_strided(sizes, strides, offset);
}

void read_config(const Archive& archive, const std::string& folder, const std::string& config,
                 const ModelLimits& limits, std::map<std::string, NamedTensor>& tensors) {
  if (!archive.has(folder + config)) return;
  PayloadFolder payloads(archive, folder, limits);
  const Json parsed = archive.json(folder + config);
  for (const auto& [name, entry] : parsed.at("config").items()) {
    try {
      if (entry.at("use_pickle").get<bool>() || entry.at("tensor_meta").is_null()) {
        throw Malformed("is pickled, which can run code and is never read; export plain tensors");
      }
      const at::Tensor& bytes = payloads.bytes(entry.at("path_name").get<std::string>());
      const at::Tensor tensor = view_of(bytes, entry.at("tensor_meta"), limits);
      if (!tensors.emplace(name, NamedTensor{tensor, entry.at("is_param").get<bool>()}).second) {
        throw Malformed("appears twice");
      }
    } catch (const std::runtime_error& error) {
      throw Malformed(fmt::format("weight '{}': {}", name, error.what()));
    } catch (const Json::exception& error) {
      throw Malformed(fmt::format("weight '{}': {}", name, error.what()));
    }
  }
}

}  // namespace

at::ScalarType scalar_type_of(int64_t code) {
  switch (code) {
    case 1:
      return at::kByte;
    case 2:
      return at::kChar;
    case 3:
      return at::kShort;
    case 4:
      return at::kInt;
    case 5:
      return at::kLong;
    case 6:
      return at::kHalf;
    case 7:
      return at::kFloat;
    case 8:
      return at::kDouble;
    case 12:
      return at::kBool;
    case 13:
      return at::kBFloat16;
    default:
      throw Malformed(fmt::format("number type {} is not supported", code));
  }
}

std::map<std::string, NamedTensor> read_tensors(const Archive& archive, const std::string& model,
                                                const ModelLimits& limits) {
  std::map<std::string, NamedTensor> tensors;
  read_config(archive, "data/weights/", model + "_weights_config.json", limits, tensors);
  read_config(archive, "data/constants/", model + "_constants_config.json", limits, tensors);
  return tensors;
}

}  // namespace tt3d::model
