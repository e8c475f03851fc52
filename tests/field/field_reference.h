#pragma once

#include <ATen/ATen.h>

#include "tt3d/field.h"

/// Slow, obvious references in plain tensor operations for the tests of the field room.
namespace tt3d::testing {

/// The result of tt3d::hash_encode, directly from section 3 of the instant-ngp paper.
at::Tensor reference_encode(const at::Tensor& x, const at::Tensor& table,
                            const field::HashGridShape& shape);

}  // namespace tt3d::testing
