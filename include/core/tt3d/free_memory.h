#pragma once

#include <cstdint>

namespace tt3d {

/// Memory in bytes that this process may still take: what the machine has free, or what its control
/// group leaves if that is less. The largest int64_t if neither is known.
[[nodiscard]] int64_t free_memory_bytes();

}  // namespace tt3d
