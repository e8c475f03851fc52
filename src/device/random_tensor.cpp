#include "tt3d/random_tensor.h"

#include <ATen/ATen.h>

#include "random_math.h"
#include "tt3d/device.h"

namespace tt3d {
namespace {

at::Tensor empty_on(at::IntArrayRef shape, at::Device device) {
  return at::empty(shape, at::TensorOptions().dtype(at::kFloat).device(device));
}

}  // namespace

at::Tensor uniform_tensor(at::IntArrayRef shape, const RandomKey& key, at::Device device) {
  at::Tensor t = empty_on(shape, device);
  const int64_t n = t.numel();
  const device::UnitBlock body = {key, t.mutable_data_ptr<float>(), n};
  for_each_index_on(t, (n + 3) / 4, body);
  return t;
}

at::Tensor uniform_tensor(at::IntArrayRef shape, double low, double high, const RandomKey& key,
                          at::Device device) {
  at::Tensor t = empty_on(shape, device);
  const int64_t n = t.numel();
  const device::RangeBlock body = {key, t.mutable_data_ptr<float>(), n, low, high};
  for_each_index_on(t, (n + 3) / 4, body);
  return t;
}

at::Tensor noise_tensor(at::IntArrayRef shape, const RandomKey& key, uint64_t first,
                        at::Device device) {
  at::Tensor t = empty_on(shape, device);
  const device::NoiseItem body = {key, t.mutable_data_ptr<float>(), first};
  for_each_index_on(t, t.numel(), body);
  return t;
}

}  // namespace tt3d
