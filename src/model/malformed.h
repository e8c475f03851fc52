#pragma once

#include <stdexcept>

namespace tt3d::model {

/// An error inside a package; Classifier::load turns it into an InputError with the file name.
class Malformed : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

}  // namespace tt3d::model
