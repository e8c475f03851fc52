#include "model/rewrite.h"

#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include "model/operators.h"

namespace tt3d::model {
namespace {

Input constant(c10::IValue value) {
  Input input;
  input.constant = std::move(value);
  return input;
}

Input slot(Slot number) {
  Input input;
  input.kind = Input::Kind::kSlot;
  input.slot = number;
  return input;
}

Step step(const char* name, std::vector<Input> inputs, Slot result) {
  Step made;
  made.name = name;
  made.op = find_operator(std::string("torch.ops.aten.") + name + ".default");
  made.target = made.op->schema().name();
  made.inputs = std::move(inputs);
  made.outputs = {{{result}, false}};
  return made;
}

constexpr Slot kPicture = 0, kWeight = 1, kPadded = 2, kResult = 3;

/// A padding, followed by a convolution with its own padding of 1 by 0.
Graph padded_convolution(std::vector<int64_t> pad, const char* mode, double value) {
  Graph graph;
  graph.names = {"x", "w", "padded", "y"};
  graph.input = kPicture;
  graph.output = kResult;
  graph.constants[kWeight] = at::ones({2, 3, 3, 3});
  graph.steps.push_back(
      step("pad", {slot(kPicture), constant(pad), constant(mode), constant(value)}, kPadded));
  graph.steps.push_back(step(
      "conv2d",
      {slot(kPadded), slot(kWeight), constant({}), constant(std::vector<int64_t>{2, 2}),
       constant(std::vector<int64_t>{1, 0}), constant(std::vector<int64_t>{1, 1}), constant(1)},
      kResult));
  return graph;
}

TEST(FoldPaddings, ZerosAlikeOnBothSidesBecomeTheConvolutions) {
  Graph graph = padded_convolution({2, 2, 3, 3}, "constant", 0);
  EXPECT_EQ(fold_paddings(graph), 1);
  ASSERT_EQ(graph.steps.size(), 1U);
  const Step& conv = graph.steps[0];
  EXPECT_EQ(conv.inputs[0].slot, kPicture);
  const auto padding = conv.inputs[4].constant.toIntVector();
  EXPECT_EQ(padding, (std::vector<int64_t>{4, 2}));
  const at::Tensor x = at::rand({1, 3, 9, 11}), w = graph.constants[kWeight];
  const at::Tensor before = at::conv2d(at::constant_pad_nd(x, {2, 2, 3, 3}), w, {}, {2, 2}, {1, 0});
  EXPECT_TRUE(at::allclose(at::conv2d(x, w, {}, {2, 2}, padding), before));
}

TEST(FoldPaddings, LeavesWhatAConvolutionCannotDo) {
  Graph sides = padded_convolution({0, 1, 0, 1}, "constant", 0);
  Graph ones = padded_convolution({1, 1, 1, 1}, "constant", 1);
  Graph mirrored = padded_convolution({1, 1, 1, 1}, "reflect", 0);
  Graph cropped = padded_convolution({-1, -1, -1, -1}, "constant", 0);
  Graph shared = padded_convolution({1, 1, 1, 1}, "constant", 0);
  shared.output = kPadded;
  for (Graph* graph : {&sides, &ones, &mirrored, &cropped, &shared}) {
    EXPECT_EQ(fold_paddings(*graph), 0);
    EXPECT_EQ(graph->steps.size(), 2U);
  }
}

}  // namespace
}  // namespace tt3d::model
