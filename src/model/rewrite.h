#pragma once

#include "graph.h"

namespace tt3d::model {

/// Folds a batch normalisation that directly follows a convolution, and is the only user of its
/// result, into the convolution's weight and bias; weights of 2D convolutions are laid out as
/// `format` says. Returns how many.
int fold_batch_norms(Graph& graph, at::MemoryFormat format);

/// Turns the batch normalisations that remain into one multiply-add with constants. That is less
/// work, and right: the backward of torch's batch_norm on the CPU (2.11) reads a gradient in the
/// wrong order at batch 1 when its strides could be channels-last (docs/model.md, "Caveats").
/// Returns how many.
int simplify_batch_norms(Graph& graph);

/// Gives convolutions the zeros that a padding before them adds alike on both sides, where nothing
/// else reads the padded picture: no copy of it is made. Returns how many.
int fold_paddings(Graph& graph);

/// False where the graph depends on the layout of its intermediate results (writes through views)
/// or has no 2D convolutions.
[[nodiscard]] bool can_use_channels_last(const Graph& graph);

/// Stores convolution weights channels-last and turns `view` into `reshape`, which holds for any
/// memory layout.
void use_channels_last(Graph& graph);

}  // namespace tt3d::model
