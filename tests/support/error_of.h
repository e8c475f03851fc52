#pragma once

#include <string>

#include "tt3d/error.h"

namespace tt3d::testing {

/// The message of the error of type E that `action` throws; "" if it throws nothing.
template <typename E = InputError, typename Action>
std::string error_of(const Action& action) {
  try {
    action();
  } catch (const E& error) {
    return error.what();
  }
  return "";
}

}  // namespace tt3d::testing
