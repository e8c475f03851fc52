#pragma once

#include <memory>
#include <vector>

#include "plan.h"
#include "plan_kernels.h"

namespace tt3d::model {

/// A 2D convolution with what follows it: clamp(convolution + sum).
struct ConvolutionSpec {
  std::string name;         ///< of the graph's node, for messages
  at::Tensor weight, bias;  ///< of the graph; [Cout,Cin/groups,kh,kw], and [Cout] or undefined
  std::vector<int64_t> stride, padding, dilation;  ///< two numbers each
  int64_t groups = 1;
  /// Zeros around the input beyond `padding`: left, right, top, bottom; TensorFlow's networks pad
  /// one side more than the other.
  std::vector<int64_t> around = {0, 0, 0, 0};
  Slot input = -1, sum = -1, output = -1;  ///< sum: -1 if nothing is added
  bool input_has_gradient = true, sum_has_gradient = true;
  Clamp clamp;
  /// Node whose activation gave the input, if this node alone reads it: its mask is applied here.
  int input_mask = -1;
  at::ScalarType gradient_type = at::kFloat;  ///< of the gradient's products and results
  bool masked_by_reader = false;  ///< the mask of this node's clamp is applied by its reader
};

/// True if the node can apply the mask of its input.
[[nodiscard]] bool applies_input_mask(const ConvolutionSpec& spec);

[[nodiscard]] std::unique_ptr<PlanNode> convolution_node(ConvolutionSpec spec);

/// clamp(input * scale + shift) per channel, of a batch normalisation that no convolution precedes.
struct AffineSpec {
  at::Tensor scale, shift;  ///< of the graph, broadcast to [C,1,1]; undefined: 1 and 0
  Slot input = -1, output = -1;
  Clamp clamp;
};
[[nodiscard]] std::unique_ptr<PlanNode> affine_node(AffineSpec spec);

/// clamp(a + b), values of equal shape.
struct SumSpec {
  Slot a = -1, b = -1, output = -1;
  bool a_has_gradient = true, b_has_gradient = true;
  Clamp clamp;
};
[[nodiscard]] std::unique_ptr<PlanNode> sum_node(SumSpec spec);

/// Steps that run through the dispatcher, recorded by autograd if a backward pass follows.
[[nodiscard]] std::unique_ptr<PlanNode> dispatched_node(std::vector<Step> steps,
                                                        std::vector<Slot> reads,
                                                        std::vector<Slot> gives);

}  // namespace tt3d::model
