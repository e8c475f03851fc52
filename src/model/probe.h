#pragma once

#include <ATen/core/Tensor.h>

#include <functional>
#include <vector>

#include "card.h"
#include "tt3d/model.h"

namespace tt3d::model {

/// The images of rule "waves-1" [batch,3,height,width], float32 in [0,1];
/// python/tt3d_tools/probe.py computes the same numbers.
[[nodiscard]] at::Tensor probe_images(int64_t batch, int64_t height, int64_t width, uint64_t seed);

/// Flat positions, in a gradient of `total` elements, of the numbers in the card.
[[nodiscard]] std::vector<int64_t> probe_positions(int64_t total, size_t count, uint64_t seed);

/// Function from images in [0,1] to logits.
using Logits = std::function<at::Tensor(const at::Tensor&)>;

/// Compares the logits of the probe with the card's. Runs forward only, image by image, so it needs
/// little memory.
[[nodiscard]] ProbeReport probe_logits(const CardFile& file, const Logits& logits);

/// Adds the gradients to the report and compares the logits again: forward and backward in whole
/// batches, with all activations in memory.
void probe_gradients(const CardFile& file, const Logits& logits, ProbeReport& report);

/// True if the differences come from rounding to `precision`, and not from another model.
[[nodiscard]] bool probe_holds(const ProbeReport& report, Precision precision);

}  // namespace tt3d::model
