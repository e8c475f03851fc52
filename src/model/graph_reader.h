#pragma once

#include "archive.h"
#include "graph.h"

namespace tt3d::model {

/// Reads the graph and its weights from an archive, and checks that it is a classifier of images:
/// one float32 input [N,3,H,W], one float32 output [N,classes] or [N,anchors,classes], allowed
/// operators only, every value defined once and before its use, no write to a weight. Throws
/// Malformed.
[[nodiscard]] Graph read_graph(const Archive& archive, const ModelLimits& limits);

/// Throws Malformed for in-place operators on weights or on views of weights.
void check_weights_are_read_only(const Graph& graph);
/// The graph's last layer if it turns logits into probabilities ("softmax", "sigmoid"), else "".
std::string probability_layer(const Graph& graph);

/// Fills Step::release: the values that no step after this one uses.
void find_last_uses(Graph& graph);

}  // namespace tt3d::model
