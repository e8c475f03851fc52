#pragma once

#include <ATen/core/stack.h>

#include "graph.h"

namespace tt3d::model {

/// Rejects arguments that some of torch's kernels (2.11) do not check: they would read out of
/// bounds, crash, or build lists too long for memory. `stack` holds the arguments of the step's
/// operator. Throws Malformed.
void check_arguments(const Step& step, const torch::jit::Stack& stack);

}  // namespace tt3d::model
