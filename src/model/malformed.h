#pragma once

#include <stdexcept>

namespace tt3d::model {

/// Something wrong inside a package; Classifier::load turns it into an InputError with the file.
class Malformed : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

}  // namespace tt3d::model
