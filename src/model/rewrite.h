#pragma once

#include "graph.h"

namespace tt3d::model {

/// Number of reads of every slot; the graph's output counts as one.
[[nodiscard]] std::vector<int> count_reads(const Graph& graph);

/// Index of an argument in the schema of a step, -1 if it has none of that name.
[[nodiscard]] int argument_index(const Step& step, const char* name);

/// Argument of that name, which the step's schema must have.
[[nodiscard]] const Input& argument(const Step& step, const char* name);

/// The weight bound to an argument; undefined if the argument is None or not a weight.
[[nodiscard]] at::Tensor weight_of(const Graph& graph, const Input& input);

[[nodiscard]] bool is_none(const Input& input);

/// A list of integers; empty if it is not one, or depends on the run.
[[nodiscard]] std::vector<int64_t> integers(const Input& input);

/// True for padding with zeros.
[[nodiscard]] bool is_zero_padding(const Step& step);

/// True if the operator writes into one of its arguments.
[[nodiscard]] bool writes_in_place(const Step& step);

/// Folds batch normalisations into the weight and bias of the convolution before them. The batch
/// normalisation must directly follow the convolution and be the only user of its result. Weights
/// of 2D convolutions get the memory format `format`. Returns the number folded.
int fold_batch_norms(Graph& graph, at::MemoryFormat format);

/// Turns each remaining batch normalisation into one multiply-add with constants. That is faster,
/// and it avoids an error: the backward pass of torch's batch_norm on the CPU (2.11) reads a
/// gradient in the wrong order at batch 1 if its strides could be channels-last (docs/model.md,
/// "Caveats"). Returns the number changed.
int simplify_batch_norms(Graph& graph);

/// Moves a symmetric zero padding into the convolution after it, if nothing else reads the padded
/// picture; this saves a copy. Returns the number folded.
int fold_paddings(Graph& graph);

/// False if the graph depends on the layout of its intermediate results (writes through views) or
/// has no 2D convolution.
[[nodiscard]] bool can_use_channels_last(const Graph& graph);

/// Stores convolution weights channels-last, and turns `view` into `reshape`, which supports any
/// memory layout.
void use_channels_last(Graph& graph);

}  // namespace tt3d::model
