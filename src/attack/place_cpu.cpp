#include "place_math.h"
#include "tt3d/device.h"

namespace tt3d::attack {
namespace {

// target_clones needs plain functions: one for each body.
#define TT3D_PLACE_ROW(BODY)                                              \
  TT3D_CPU_LOOP void row_of(const BODY& shared, int64_t n, int64_t row) { \
    const BODY body = shared;                                             \
    for (int64_t x = 0; x < body.p.size; ++x) body(n, row, x);            \
  }
TT3D_PLACE_ROW(PlacePixel<float>)
TT3D_PLACE_ROW(PlacePixel<double>)
TT3D_PLACE_ROW(PlaceBackwardPixel<float>)
TT3D_PLACE_ROW(PlaceBackwardPixel<double>)
#undef TT3D_PLACE_ROW

template <typename Body>
void for_each_row(int64_t pictures, const Body& body) {
  for_each_task(pictures, [&](int64_t n) {
    for (int64_t row = 0; row < body.p.size; ++row) row_of(body, n, row);
  });
}

}  // namespace

void for_each_pixel(const Cpu&, int64_t pictures, const PlacePixel<float>& body) {
  for_each_row(pictures, body);
}
void for_each_pixel(const Cpu&, int64_t pictures, const PlacePixel<double>& body) {
  for_each_row(pictures, body);
}
void for_each_pixel(const Cpu&, int64_t pictures, const PlaceBackwardPixel<float>& body) {
  for_each_row(pictures, body);
}
void for_each_pixel(const Cpu&, int64_t pictures, const PlaceBackwardPixel<double>& body) {
  for_each_row(pictures, body);
}

}  // namespace tt3d::attack
