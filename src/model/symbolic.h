#pragma once

#include <string>

#include "graph.h"

namespace tt3d::model {

/// Arithmetic on sizes: "_operator.mul", "torch.sym_max", "math.ceil" and similar; null for
/// anything else. The functions throw Malformed for overflow, division by zero and wrong types.
[[nodiscard]] SymbolicFunction find_symbolic(const std::string& target);

}  // namespace tt3d::model
