#include "random_math.h"
#include "tt3d/cuda.h"

namespace tt3d::device {

void fill(const Cuda& on, int64_t items, const UnitBlock& body) { for_each_index(on, items, body); }
void fill(const Cuda& on, int64_t items, const RangeBlock& body) {
  for_each_index(on, items, body);
}
void fill(const Cuda& on, int64_t items, const NoiseItem& body) { for_each_index(on, items, body); }

}  // namespace tt3d::device
