#pragma once

#include <string>
#include <vector>

#include "tt3d/core.h"

namespace tt3d::testing {

/// A quiet Progress that keeps its notes.
struct KeepNotes : Progress {
  void note(const std::string& line) override { lines.push_back(line); }
  /// True if one of the notes contains `text`.
  [[nodiscard]] bool contain(const std::string& text) const {
    for (const std::string& line : lines) {
      if (line.find(text) != std::string::npos) return true;
    }
    return false;
  }
  std::vector<std::string> lines;
};

}  // namespace tt3d::testing
