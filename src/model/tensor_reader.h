#pragma once

#include <ATen/core/Tensor.h>

#include <map>
#include <string>

#include "archive.h"

namespace tt3d::model {

/// A named tensor of the archive.
struct NamedTensor {
  at::Tensor tensor;
  bool is_parameter = false;
};

/// The scalar type of a number in torch's export schema; throws Malformed for unknown ones.
[[nodiscard]] at::ScalarType scalar_type_of(int64_t code);

/// Reads all weights and constants; names with the same file share its memory. Throws Malformed for
/// pickled payloads and for tensors that extend beyond their file.
[[nodiscard]] std::map<std::string, NamedTensor> read_tensors(const Archive& archive,
                                                              const std::string& model,
                                                              const ModelLimits& limits);

}  // namespace tt3d::model
