#include "composite_math.h"
#include "hash_math.h"
#include "march_math.h"
#include "rays_math.h"
#include "tt3d/cuda.h"

// Bodies of the field that run on the GPU with one thread per item.
namespace tt3d {

#define TT3D_INSTANTIATE(T)                                                                  \
  template void for_each_index(const Cuda&, int64_t, const field::HashEncodeItem<T, 1>&);    \
  template void for_each_index(const Cuda&, int64_t, const field::HashEncodeItem<T, 2>&);    \
  template void for_each_index(const Cuda&, int64_t, const field::HashScatterItem<T, 1>&);   \
  template void for_each_index(const Cuda&, int64_t, const field::HashScatterItem<T, 2>&);   \
  template void for_each_index(const Cuda&, int64_t, const field::HashPointGradient<T, 1>&); \
  template void for_each_index(const Cuda&, int64_t, const field::HashPointGradient<T, 2>&); \
  template void for_each_index(const Cuda&, int64_t, const field::CompositeRay<T>&);         \
  template void for_each_index(const Cuda&, int64_t, const field::CompositeBackwardRay<T>&);
TT3D_INSTANTIATE(float)
TT3D_INSTANTIATE(double)
#undef TT3D_INSTANTIATE

template void for_each_index(const Cuda&, int64_t, const field::CoarseCell&);
template void for_each_index(const Cuda&, int64_t, const field::CountSamples&);
template void for_each_index(const Cuda&, int64_t, const field::WriteSamples&);
template void for_each_index(const Cuda&, int64_t, const field::CountVisible&);
template void for_each_index(const Cuda&, int64_t, const field::WriteFirst&);
template void for_each_index(const Cuda&, int64_t, const field::CountRound&);
template void for_each_index(const Cuda&, int64_t, const field::WriteRound&);
template void for_each_index(const Cuda&, int64_t, const field::AddRound&);
template void for_each_index(const Cuda&, int64_t, const field::RepeatDirection&);
template void for_each_index(const Cuda&, int64_t, const field::DrawRay&);
template void for_each_index(const Cuda&, int64_t, const field::RowRay&);
template void for_each_index(const Cuda&, int64_t, const field::CellPoint&);

}  // namespace tt3d
