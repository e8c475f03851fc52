#pragma once

#include "tt3d/core.h"

namespace tt3d::testing {

/// Stops the work after a number of updates, like Ctrl-C.
struct StopAfter : Progress {
  explicit StopAfter(int n) : left(n) {}
  void update(int64_t, const Metrics&) override { --left; }
  [[nodiscard]] bool cancelled() const override { return left <= 0; }
  int left;
};

}  // namespace tt3d::testing
