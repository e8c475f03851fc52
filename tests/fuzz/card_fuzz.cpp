// Any bytes as a card: the values are within the documented ranges, or it is rejected with
// InputError.

#include "card.h"
#include "memory_file.h"
#include "tt3d/error.h"

namespace {

void require(bool holds) {
  if (!holds) __builtin_trap();
}

void check(const tt3d::model::CardFile& file) {
  const tt3d::model::ModelCard& card = file.card;
  require(card.height >= 1 && card.width >= 1 && card.resize >= card.height);
  require(card.mean.size() == 3 && card.std.size() == 3 && !card.labels.empty());
  require(card.sha256.size() == 64);
  for (const double value : card.std) require(value > 0);
  for (const auto& one : file.probe.cases) {
    require(one.logits.size() == static_cast<size_t>(one.batch) && !one.gradient.empty());
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  const tt3d::testing::MemoryFile file(data, size);
  try {
    check(tt3d::model::read_card(file.path(), {}));
  } catch (const tt3d::InputError&) {
    return 0;
  }
  return 0;
}
