#include "tt3d/random_tensor.h"

#include <ATen/ATen.h>

#include "random_math.h"
#include "tt3d/device.h"

namespace tt3d {
namespace {

at::Tensor empty_on(at::IntArrayRef shape, at::Device device) {
  return at::empty(shape, at::TensorOptions().dtype(at::kFloat).device(device));
}

/// Whole blocks, vectorised.
TT3D_CPU_LOOP void make_noise(const device::NoiseBlock& body, int64_t begin, int64_t end) {
  const device::NoiseBlock noise = body;
#pragma GCC ivdep
  for (int64_t i = begin; i < end; ++i) noise.pair(i, noise.out[2 * i], noise.out[2 * i + 1]);
}

}  // namespace

/// Overload resolution in for_each_index_on prefers this to the general loop.
void for_each_index(const Cpu&, int64_t blocks, const device::NoiseBlock& body) {
  constexpr int64_t kChunk = 4096;
  const int64_t whole = body.count / 2;
  for_each_chunk(whole, kChunk, [&](int64_t begin, int64_t end) { make_noise(body, begin, end); });
  if (blocks > whole) body(whole);
}

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

at::Tensor noise_tensor(at::IntArrayRef shape, const RandomKey& key, at::Device device) {
  at::Tensor t = empty_on(shape, device);
  const int64_t n = t.numel();
  const device::NoiseBlock body = {key, t.mutable_data_ptr<float>(), n};
  for_each_index_on(t, (n + 1) / 2, body);
  return t;
}

}  // namespace tt3d
