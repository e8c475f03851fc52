#pragma once

#include "adam_math.h"

namespace tt3d::optimize {

/// The loop of Adam on the CPU, in place of the general one.
void for_each_index(const Cpu&, int64_t n, const AdamEntry& body);

}  // namespace tt3d::optimize
