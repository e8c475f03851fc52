#pragma once

#include <ATen/ATen.h>

#include "tt3d/field.h"

/// Slow, obvious references in plain tensor operations: the oracles of the field room.
namespace tt3d::testing {

/// The same answer as tt3d::hash_encode, straight from section 3 of the instant-ngp paper.
at::Tensor reference_encode(const at::Tensor& x, const at::Tensor& table,
                            const HashGridShape& shape);

}  // namespace tt3d::testing
