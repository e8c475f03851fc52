#pragma once

#include <string>

#include "graph.h"

namespace tt3d::model {

/// Resolves "torch.ops.aten.NAME.OVERLOAD" against the allow-list and the dispatcher; throws
/// Malformed for anything else. Allowed operators compute tensors from tensors and numbers: no
/// random numbers, no files, no access to memory that is not an argument's.
[[nodiscard]] c10::OperatorHandle find_operator(const std::string& target);

/// True for operators that only check what the reader has already checked; they do not run.
[[nodiscard]] bool is_assertion(const std::string& target);

/// Throws Malformed for arguments that would train or draw random numbers (training=True, dropout).
void check_evaluation_mode(const Step& step);

}  // namespace tt3d::model
