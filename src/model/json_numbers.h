#pragma once

#include <nlohmann/json.hpp>

#include "malformed.h"

namespace tt3d::model {

/// A 64-bit integer. The library's own conversion truncates 1.5 to 1, and 4e23 is undefined
/// behaviour.
template <typename Json>
int64_t read_integer(const Json& value) {
  if (!value.is_number_integer()) {
    throw Malformed(std::string("expected a 64-bit integer, not a ") + value.type_name() +
                    (value.is_number() ? " with a fraction or out of range" : ""));
  }
  return value.template get<int64_t>();
}

}  // namespace tt3d::model
