#include "field/field_reference.h"

#include <cmath>

namespace tt3d::testing {

using at::Tensor;

Tensor reference_encode(const Tensor& x, const Tensor& table, const field::HashGridShape& shape) {
  std::vector<Tensor> rows;
  int64_t offset = 0;
  for (int64_t l = 0; l < shape.levels; ++l) {
    const double growth =
        std::log(double(shape.finest) / double(shape.base)) / double(shape.levels - 1);
    const double exact = double(shape.base) * std::exp(growth * double(l));
    const double scale = static_cast<double>(static_cast<float>(exact));
    const auto resolution = static_cast<int64_t>(std::ceil(exact)) + 2;
    const bool dense = resolution * resolution * resolution <= (int64_t{1} << shape.log2_size);
    const int64_t size =
        dense ? resolution * resolution * resolution : int64_t{1} << shape.log2_size;
    const Tensor position = ((x + 1) * 0.5).clamp(0, 1) * scale + 0.5;
    const Tensor cell = position.detach().floor();
    const Tensor fraction = position - cell;
    Tensor sum = at::zeros({x.size(0), shape.features}, x.options());
    for (int64_t corner = 0; corner < 8; ++corner) {
      Tensor weight = at::ones({x.size(0)}, x.options());
      std::vector<Tensor> c;
      for (int64_t k = 0; k < 3; ++k) {
        const int64_t bit = (corner >> k) & 1;
        const Tensor f = fraction.select(1, k);
        weight = weight * (bit ? f : 1 - f);
        c.push_back(cell.select(1, k).to(at::kLong) + bit);
      }
      Tensor index;
      if (dense) {
        index = c[0] + resolution * (c[1] + resolution * c[2]);
      } else {
        const int64_t mask32 = 0xFFFFFFFFLL;
        index = at::bitwise_xor(at::bitwise_xor(c[0], (c[1] * 2654435761LL).bitwise_and(mask32)),
                                (c[2] * 805459861LL).bitwise_and(mask32))
                    .remainder(size);
      }
      sum = sum + weight.unsqueeze(1) * table.index_select(0, index + offset);
    }
    rows.push_back(sum.t());
    offset += size;
  }
  return at::cat(rows);
}

}  // namespace tt3d::testing
