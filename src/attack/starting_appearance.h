#pragma once

#include <memory>

#include "tt3d/attack.h"

namespace tt3d::attack {

/// The appearance whose parts are optimised. It starts with the colours of the clean object if it
/// can represent them. Throws InputError for parts that cannot be combined or a missing UV map.
[[nodiscard]] std::unique_ptr<object::Appearance> starting_appearance(const AttackInput& input,
                                                                      const AttackOptions& options);

}  // namespace tt3d::attack
