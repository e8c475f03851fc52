#include "pixels_cpu.h"
#include "raster_kernels.h"

namespace tt3d::raster {

template <typename T>
void scatter(const Cpu&, const AntialiasPixel<T>& body) {
  for_each_pixel_in_order(body.s, body);
}

template <typename T>
void scatter(const Cpu&, const AntialiasBackwardPixel<T>& body) {
  for_each_pixel_in_order(body.s, body);
}

template void scatter(const Cpu&, const AntialiasPixel<float>&);
template void scatter(const Cpu&, const AntialiasPixel<double>&);
template void scatter(const Cpu&, const AntialiasBackwardPixel<float>&);
template void scatter(const Cpu&, const AntialiasBackwardPixel<double>&);

}  // namespace tt3d::raster
