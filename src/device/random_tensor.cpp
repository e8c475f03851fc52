#include "tt3d/random_tensor.h"

#include <ATen/ATen.h>

#include "random_math.h"
#include "tt3d/device.h"

namespace tt3d {
namespace device {

void fill(const Cpu&, int64_t items, const UnitBlock& body) { for_each_index(items, body); }
void fill(const Cpu&, int64_t items, const RangeBlock& body) { for_each_index(items, body); }
void fill(const Cpu&, int64_t items, const NoiseItem& body) { for_each_index(items, body); }

}  // namespace device

namespace {

at::Tensor empty_on(at::IntArrayRef shape, at::Device device) {
  return at::empty(shape, at::TensorOptions().dtype(at::kFloat).device(device));
}

}  // namespace

at::Tensor uniform_tensor(at::IntArrayRef shape, const RandomKey& key, at::Device device) {
  at::Tensor t = empty_on(shape, device);
  const int64_t n = t.numel();
  const device::UnitBlock body = {key, t.mutable_data_ptr<float>(), n};
  on_device_of(t, [&](const auto& on) { device::fill(on, (n + 3) / 4, body); });
  return t;
}

at::Tensor uniform_tensor(at::IntArrayRef shape, double low, double high, const RandomKey& key,
                          at::Device device) {
  at::Tensor t = empty_on(shape, device);
  const int64_t n = t.numel();
  const device::RangeBlock body = {key, t.mutable_data_ptr<float>(), n, low, high};
  on_device_of(t, [&](const auto& on) { device::fill(on, (n + 3) / 4, body); });
  return t;
}

at::Tensor noise_tensor(at::IntArrayRef shape, const RandomKey& key, uint64_t first,
                        at::Device device) {
  at::Tensor t = empty_on(shape, device);
  const device::NoiseItem body = {key, t.mutable_data_ptr<float>(), first};
  on_device_of(t, [&](const auto& on) { device::fill(on, t.numel(), body); });
  return t;
}

}  // namespace tt3d
