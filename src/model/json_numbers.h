#pragma once

#include <nlohmann/json.hpp>

#include "malformed.h"

namespace tt3d::model {

/// A whole number of 64 bits. The library's own conversion cuts 1.5 to 1 and makes of 4e23 what the
/// processor likes (undefined behaviour).
template <typename Json>
int64_t read_integer(const Json& value) {
  if (!value.is_number_integer()) {
    throw Malformed(std::string("a whole number is expected, not a ") + value.type_name() +
                    (value.is_number() ? " with a fraction or of that size" : ""));
  }
  return value.template get<int64_t>();
}

}  // namespace tt3d::model
