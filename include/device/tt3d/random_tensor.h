#pragma once

#include <ATen/core/Tensor.h>

#include "tt3d/philox.h"

/// Random float32 tensors of a stream (tt3d::Random): the same numbers on every device.
namespace tt3d {

/// Uniform in [0,1), 24 bits: element i comes from word i of the stream.
[[nodiscard]] at::Tensor uniform_tensor(at::IntArrayRef shape, const RandomKey& key,
                                        at::Device device);
/// Uniform in [low, high), 32 bits: element i comes from word i of the stream.
[[nodiscard]] at::Tensor uniform_tensor(at::IntArrayRef shape, double low, double high,
                                        const RandomKey& key, at::Device device);
/// Approximately normal, mean 0 and variance 1: sums of four uniform 16-bit numbers. Element i
/// comes from words 2 i and 2 i + 1 of the stream.
[[nodiscard]] at::Tensor noise_tensor(at::IntArrayRef shape, const RandomKey& key,
                                      at::Device device);

}  // namespace tt3d
