#pragma once

#include <ATen/core/Tensor.h>

#include <filesystem>
#include <map>
#include <string>
#include <utility>
#include <vector>

/// Named tensors in one file, in the safetensors format (8-byte header length, JSON header, raw
/// little-endian data). Python opens these files too, and nothing in them is executed.
namespace tt3d {

/// The content of such a file. dtypes: F32, F64, I32, I64, U8.
struct TensorFile {
  std::filesystem::path path;  ///< for error messages
  std::map<std::string, at::Tensor> tensors;
  std::map<std::string, std::string> metadata;
  /// The tensor of that name, shape (-1: any size) and dtype. Throws InputError that names what
  /// differs.
  [[nodiscard]] at::Tensor get(const std::string& name, at::IntArrayRef shape,
                               at::ScalarType dtype) const;
};

/// Writes atomically. Throws ResourceError on failure.
void save_tensors(const std::filesystem::path& path,
                  const std::vector<std::pair<std::string, at::Tensor>>& tensors,
                  const std::map<std::string, std::string>& metadata);

/// Reads a whole file. Throws InputError for anything malformed: truncated, offsets outside the
/// data or not matching shape and dtype, unknown dtype, bad JSON.
[[nodiscard]] TensorFile load_tensors(const std::filesystem::path& path);

}  // namespace tt3d
