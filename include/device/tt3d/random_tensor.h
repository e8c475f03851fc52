#pragma once

#include <ATen/core/Tensor.h>

#include "tt3d/philox.h"

/// Random float32 tensors of a stream (tt3d::Random): the same numbers on every device.
namespace tt3d {

/// Uniform in [0,1), 24 bits: element i is made of the stream's word i.
[[nodiscard]] at::Tensor uniform_tensor(at::IntArrayRef shape, const RandomKey& key,
                                        at::Device device);
/// Uniform in [low, high), 32 bits: element i is made of the stream's word i.
[[nodiscard]] at::Tensor uniform_tensor(at::IntArrayRef shape, double low, double high,
                                        const RandomKey& key, at::Device device);
/// Mean 0 and variance 1, near enough to normal: sums of four uniform numbers of 16 bits. Element i
/// is made of the stream's words 2 i and 2 i + 1.
[[nodiscard]] at::Tensor noise_tensor(at::IntArrayRef shape, const RandomKey& key,
                                      at::Device device);

}  // namespace tt3d
