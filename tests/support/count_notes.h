#pragma once

#include "tt3d/core.h"

namespace tt3d::testing {

/// A quiet Progress that counts its notes.
struct CountNotes : Progress {
  void note(const std::string&) override { ++count; }
  int count = 0;
};

}  // namespace tt3d::testing
