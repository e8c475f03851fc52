#include "tt3d/core.h"

namespace tt3d {

Recovery Recovery::after_divergence(std::string_view stage, int64_t step, std::string_view advice,
                                    Progress& progress) const {
  constexpr int kMaxRollbacks = 3;
  const std::string what = std::string(stage) + " diverged at step " + std::to_string(step);
  if (rollbacks == kMaxRollbacks) {
    throw NumericError(what + " after three roll-backs; " + std::string(advice));
  }
  const Recovery next = {rollbacks + 1, rate_scale * 0.5};
  progress.note(what + ": rolling back, learning rates x " + std::to_string(next.rate_scale));
  return next;
}

}  // namespace tt3d
