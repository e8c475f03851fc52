#pragma once

#include <ATen/core/stack.h>

#include "graph.h"

namespace tt3d::model {

/// Refuses arguments that some of torch's kernels (2.11) follow without a check: out of bounds,
/// into a crash, or into lists too long to hold. `stack` holds the arguments of the step's
/// operator. Throws Malformed.
void check_arguments(const Step& step, const torch::jit::Stack& stack);

}  // namespace tt3d::model
