#pragma once

#include <functional>
#include <nlohmann/json.hpp>
#include <string>

#include "graph.h"

namespace tt3d::model {

/// Finds the slot of a defined value; throws Malformed for undefined names.
using SlotOf = std::function<Slot(const std::string& name)>;

/// Converts an argument of the JSON graph to the type in an operator's schema. Throws Malformed if
/// the kind of the value does not fit. `fixed_size` is the length of a list that also accepts a
/// single number.
[[nodiscard]] Input read_argument(const nlohmann::json& argument, const c10::TypePtr& type,
                                  std::optional<int32_t> fixed_size, const SlotOf& slot_of);

/// An argument of arithmetic on sizes: integers, reals, booleans and symbols.
[[nodiscard]] Input read_number(const nlohmann::json& argument, const SlotOf& slot_of);

}  // namespace tt3d::model
