#include <memory>

#include "half_mlp_math.h"
#include "tt3d/device.h"

namespace tt3d::field {

template <typename Share>
void run_teams(const Cpu&, int64_t teams, const Share& share) {
  at::parallel_for(0, teams, 1, [&](int64_t first, int64_t last) {
    // new char[] is aligned for every type stored in it.
    const std::unique_ptr<char[]> memory(new char[share.bytes(OneThread::warps())]);
    for (int64_t t = first; t < last; ++t) share(OneThread{}, memory.get(), t, teams);
  });
}

#define TT3D_INSTANTIATE(LAYERS)                                            \
  template void run_teams(const Cpu&, int64_t, const HalfForward<LAYERS>&); \
  template void run_teams(const Cpu&, int64_t, const HalfBackward<LAYERS>&);
TT3D_FOR_EACH_DEPTH(TT3D_INSTANTIATE)
#undef TT3D_INSTANTIATE

}  // namespace tt3d::field
