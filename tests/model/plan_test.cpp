#include "model/plan.h"

#include <ATen/ATen.h>
#include <gtest/gtest.h>
#include <torch/csrc/autograd/autograd.h>

#include <limits>

#include "model/graph_reader.h"
#include "model/operators.h"
#include "model/plan_kernels.h"
#include "model/program.h"

namespace tt3d::model {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

at::Tensor channels_last(const at::Tensor& tensor) {
  return tensor.contiguous(at::MemoryFormat::ChannelsLast);
}

double cosine_of(const at::Tensor& a, const at::Tensor& b) {
  return ((a * b).sum() / (a.norm() * b.norm())).item<double>();
}

// ---- Masks --------------------------------------------------------------------------------

TEST(PlanMask, KeepsTheGradientWhereTheClampHasSlopeOne) {
  at::manual_seed(1);
  for (const auto type : {at::kFloat, at::kBFloat16, at::kDouble}) {
    for (const double high : {6.0, kInfinity}) {
      for (const int64_t n : {1, 15, 16, 17, 70001}) {
        const at::Tensor y = (at::randn({n}) * 5).clamp(0, high).to(type);
        const at::Tensor gradient = at::randn({n}).to(type), result = gradient.clone();
        apply_bits(result, slope_bits(y, {true, high}));
        const at::Tensor expected = gradient * ((y > 0) & (y < high)).to(type);
        EXPECT_TRUE(result.equal(expected)) << type << " " << high << " " << n;
      }
    }
  }
}

// ---- Depthwise convolutions ---------------------------------------------------------------

struct DepthwiseCase {
  int64_t kernel, stride, before, after, height, width;
};
const DepthwiseCase kDepthwise[] = {{3, 1, 1, 1, 7, 9}, {3, 2, 1, 1, 8, 7}, {3, 2, 0, 1, 8, 8},
                                    {5, 1, 2, 2, 6, 5}, {5, 2, 1, 2, 9, 8}, {5, 2, 2, 2, 7, 7},
                                    {3, 1, 0, 0, 3, 5}, {5, 1, 2, 2, 2, 1}, {3, 2, 2, 0, 5, 6}};

at::Tensor padded_depthwise(const at::Tensor& x, const at::Tensor& weight, const at::Tensor& bias,
                            const DepthwiseCase& c) {
  const at::Tensor in = at::constant_pad_nd(x, {c.before, c.after, c.before, c.after});
  const std::vector<int64_t> stride = {c.stride, c.stride}, none = {0, 0}, one = {1, 1};
  return at::conv2d(in, weight, bias, stride, at::IntArrayRef(none), one, weight.size(0));
}

TEST(PlanDepthwise, EqualsTheTensorReference) {
  at::manual_seed(2);
  for (const DepthwiseCase& c : kDepthwise) {
    const at::Tensor x = channels_last(at::randn({2, 32, c.height, c.width}, at::kDouble));
    const at::Tensor weight = at::randn({32, 1, c.kernel, c.kernel}, at::kDouble);
    const at::Tensor bias = at::randn({32}, at::kDouble);
    const DepthwiseShape shape{32, c.kernel, c.stride, c.before, c.after};
    ASSERT_TRUE(has_depthwise_kernel(shape));
    const Depthwise ours(shape, weight, bias, at::kDouble);
    at::Tensor bits;
    const at::Tensor y = ours.forward(x, {true, 2}, &bits);
    const at::Tensor leaf = x.clone().requires_grad_(true);
    const at::Tensor plain = padded_depthwise(leaf, weight, bias, c);
    const at::Tensor gradient = channels_last(at::randn(plain.sizes(), at::kDouble));
    EXPECT_TRUE(at::allclose(y, plain.clamp(0, 2), 1e-12, 1e-12)) << c.kernel << " " << c.stride;
    EXPECT_TRUE(bits.equal(slope_bits(y, {true, 2})));

    const at::Tensor before = at::randn_like(x), mask = slope_bits(before, {true, 1});
    const at::Tensor expected = torch::autograd::grad({plain}, {leaf}, {gradient})[0];
    const at::Tensor whole = ours.backward(gradient, c.height, c.width, {});
    EXPECT_TRUE(at::allclose(whole, expected, 1e-12, 1e-12)) << c.kernel << " " << c.stride;
    const at::Tensor masked = ours.backward(gradient, c.height, c.width, mask);
    EXPECT_TRUE(at::allclose(masked, expected * ((before > 0) & (before < 1)), 1e-12, 1e-12));
  }
}

TEST(PlanDepthwise, GradientEqualsCentralDifferences) {
  at::manual_seed(3);
  const Depthwise ours({16, 3, 2, 0, 1}, at::randn({16, 1, 3, 3}, at::kDouble), {}, at::kDouble);
  const at::Tensor x = channels_last(at::randn({1, 16, 4, 4}, at::kDouble));
  const at::Tensor gradient = channels_last(at::randn({1, 16, 2, 2}, at::kDouble));
  const at::Tensor found = ours.backward(gradient, 4, 4, {});
  const double step = 1e-5;
  for (const int64_t i : {0, 37, 100, 255}) {
    const auto loss = [&](double change) {
      at::Tensor moved = x.clone(at::MemoryFormat::Preserve);
      moved.as_strided({256}, {1})[i] += change;
      return (ours.forward(moved, {}, nullptr) * gradient).sum().item<double>();
    };
    const double expected = (loss(step) - loss(-step)) / (2 * step);
    EXPECT_NEAR(found.as_strided({256}, {1})[i].item<double>(), expected, 1e-8) << i;
  }
}

TEST(PlanDepthwise, StoresBfloat16RoundedToNearest) {
  at::manual_seed(4);
  for (const DepthwiseCase& c : kDepthwise) {
    const at::Tensor weight = at::randn({16, 1, c.kernel, c.kernel});
    const Depthwise ours({16, c.kernel, c.stride, c.before, c.after}, weight, {}, at::kFloat);
    const at::Tensor x = channels_last(at::randn({1, 16, c.height, c.width})).to(at::kBFloat16);
    const at::Tensor exact = ours.forward(x.to(at::kFloat), {}, nullptr);
    EXPECT_TRUE(ours.forward(x, {}, nullptr).equal(exact.to(at::kBFloat16)));
  }
}

// ---- Plans --------------------------------------------------------------------------------

Input fixed(c10::IValue value) {
  Input input;
  input.constant = std::move(value);
  return input;
}

/// Builds graphs step by step.
class Builder {
 public:
  explicit Builder(int64_t side) {
    graph.height = graph.width = side;
    graph.classes = 5;
    graph.max_batch = 8;
    graph.input = value("x");
  }

  Slot weight(const at::Tensor& tensor) {
    const Slot slot = value("w");
    graph.constants[slot] = tensor.dim() == 4 ? channels_last(tensor) : tensor;
    return slot;
  }

  static Input read(Slot slot) {
    Input input;
    input.kind = Input::Kind::kSlot;
    input.slot = slot;
    return input;
  }

  Slot add(const std::string& op, std::vector<Input> inputs) {
    Step step;
    step.name = op;
    step.op = find_operator("torch.ops.aten." + op);
    step.target = step.op->schema().name();
    step.inputs = std::move(inputs);
    const Slot result = value(op);
    step.outputs = {{{result}, false}};
    graph.steps.push_back(std::move(step));
    return result;
  }

  Slot conv(Slot in, const at::Tensor& w, int64_t stride, int64_t padding, int64_t groups = 1,
            int64_t dilation = 1) {
    const auto two = [](int64_t n) { return fixed(std::vector<int64_t>{n, n}); };
    const Slot bias = weight(at::randn({w.size(0)}) * 0.3);
    return add("conv2d.default", {read(in), read(weight(w * 0.3)), read(bias), two(stride),
                                  two(padding), two(dilation), fixed(groups)});
  }
  Slot relu(Slot in) { return add("relu.default", {read(in)}); }
  Slot relu6(Slot in) { return add("hardtanh.default", {read(in), fixed(0.0), fixed(6.0)}); }
  Slot sum(Slot a, Slot b) { return add("add.Tensor", {read(a), read(b), fixed(1)}); }

  /// Averages the pictures and gives five logits.
  Graph finish(Slot features, int64_t channels) {
    const Slot mean = add(
        "mean.dim", {read(features), fixed(std::vector<int64_t>{2, 3}), fixed(false), fixed({})});
    const Slot linear = weight(at::randn({5, channels}));
    graph.output = add("linear.default", {read(mean), read(linear), fixed({})});
    find_last_uses(graph);
    return graph;
  }

  Graph graph;

 private:
  Slot value(const char* name) {
    graph.names.emplace_back(name);
    return static_cast<Slot>(graph.names.size()) - 1;
  }
  Slot value(const std::string& name) { return value(name.c_str()); }
};

at::Tensor plain_logits(const Graph& graph, const at::Tensor& images) {
  MemoryMeter meter(1LL << 40, true);
  return run_graph(graph, images, meter);
}

/// Compares the plan of a graph with the graph.
void expect_same(const Graph& graph, const std::string& what) {
  const at::Tensor images =
      channels_last(at::rand({3, 3, graph.height, graph.width})) * 2 - at::ones({1});
  const auto run = [&](const auto& logits_of) {
    const at::Tensor leaf = images.detach().requires_grad_(true);
    const at::Tensor logits = logits_of(leaf);
    return std::pair(logits.detach(), torch::autograd::grad({logits.square().sum()}, {leaf})[0]);
  };
  const auto expected = run([&](const at::Tensor& leaf) { return plain_logits(graph, leaf); });
  MemoryMeter meter(1LL << 40, true);
  for (const Precision precision : {Precision::kFloat32, Precision::kBfloat16}) {
    const auto plan = compile_plan(graph, precision, 1LL << 40);
    ASSERT_NE(plan, nullptr) << what;
    for (int round = 0; round < 2; ++round) {
      const auto found = run([&](const at::Tensor& leaf) { return plan->logits(leaf, meter); });
      EXPECT_TRUE(at::allclose(found.first, expected.first, 1e-4, 1e-4)) << what;
      const double least = precision == Precision::kFloat32 ? 0.99999 : 0.99;
      EXPECT_GT(cosine_of(found.second, expected.second), least) << what;
      const double ratio = (found.second.norm() / expected.second.norm()).item<double>();
      EXPECT_NEAR(ratio, 1, precision == Precision::kFloat32 ? 1e-4 : 0.02) << what;
    }
    EXPECT_TRUE(plan->weights_hold()) << what;
    const at::NoGradGuard none;
    EXPECT_TRUE(at::allclose(plan->logits(images, meter), expected.first, 1e-4, 1e-4)) << what;
  }
}

TEST(Plan, InvertedResidualsEqualTheGraph) {
  at::manual_seed(5);
  Builder b(17);
  const Slot pad =
      b.add("constant_pad_nd.default",
            {Builder::read(b.graph.input), fixed(std::vector<int64_t>{0, 1, 0, 1}), fixed(0.0)});
  const Slot stem = b.relu6(b.conv(pad, at::randn({16, 3, 3, 3}), 2, 0));
  const Slot wide = b.relu6(b.conv(stem, at::randn({32, 16, 1, 1}), 1, 0));
  const Slot deep = b.relu6(b.conv(wide, at::randn({32, 1, 3, 3}), 1, 1, 32));
  const Slot narrow = b.sum(stem, b.conv(deep, at::randn({16, 32, 1, 1}), 1, 0));
  const Slot down = b.relu6(b.conv(b.relu6(b.conv(narrow, at::randn({48, 16, 1, 1}), 1, 0)),
                                   at::randn({48, 1, 5, 5}), 2, 2, 48));
  expect_same(b.finish(down, 48), "inverted residuals");
}

TEST(Plan, BottlenecksEqualTheGraph) {
  at::manual_seed(6);
  Builder b(18);
  const Slot stem = b.relu(b.conv(b.graph.input, at::randn({8, 3, 7, 7}), 2, 3));
  const Slot inner = b.relu(b.conv(stem, at::randn({16, 8, 3, 3}), 2, 1));
  const Slot skipped = b.conv(stem, at::randn({16, 8, 1, 1}), 2, 0);
  const Slot joined = b.relu(b.sum(b.conv(inner, at::randn({16, 16, 1, 1}), 1, 0), skipped));
  const Slot grouped = b.relu(b.conv(joined, at::randn({16, 4, 3, 3}), 1, 2, 4, 2));
  const Slot again = b.relu6(b.sum(grouped, b.conv(grouped, at::randn({16, 16, 3, 3}), 1, 1)));
  expect_same(b.finish(again, 16), "bottlenecks");
}

TEST(Plan, OtherOperatorsRunThroughTheDispatcher) {
  at::manual_seed(7);
  Builder b(16);
  const Slot stem = b.conv(b.graph.input, at::randn({16, 3, 3, 3}), 2, 1);
  const Slot swish = b.add("silu.default", {Builder::read(stem)});
  const Slot gate =
      b.add("sigmoid.default", {Builder::read(b.conv(swish, at::randn({16, 16, 1, 1}), 1, 0))});
  const Slot scaled = b.add("mul.Tensor", {Builder::read(swish), Builder::read(gate)});
  const Slot shift = b.weight(at::randn({16, 1, 1})), scale = b.weight(at::randn({16, 1, 1}));
  const Slot norm = b.relu(b.add("addcmul.default", {Builder::read(shift), Builder::read(scaled),
                                                     Builder::read(scale), fixed(1)}));
  const Slot last = b.conv(norm, at::randn({24, 16, 3, 3}), 1, 0);
  expect_same(b.finish(b.sum(last, last), 24), "squeeze and excite");
}

TEST(Plan, NoneForGraphsThatItCannotFollow) {
  at::manual_seed(8);
  Builder shared(8);
  const Slot a = shared.conv(shared.graph.input, at::randn({16, 3, 3, 3}), 1, 1);
  const Slot changed = shared.add("relu_.default", {Builder::read(a)});  // also changes a
  const Graph written =
      shared.finish(shared.sum(a, shared.conv(changed, at::randn({16, 16, 1, 1}), 1, 0)), 16);
  EXPECT_EQ(compile_plan(written, Precision::kFloat32, 1LL << 40), nullptr);

  Builder patches(8);
  const Slot one = patches.conv(patches.graph.input, at::randn({16, 3, 4, 4}), 4, 0);
  EXPECT_EQ(compile_plan(patches.finish(one, 16), Precision::kFloat32, 1LL << 40), nullptr);
}

TEST(Plan, InPlaceOperatorsWithoutOtherReadersAreFollowed) {
  at::manual_seed(9);
  Builder b(9);
  const Slot a = b.conv(b.graph.input, at::randn({16, 3, 3, 3}), 1, 1);
  const Slot relu = b.add("relu_.default", {Builder::read(a)});
  expect_same(b.finish(b.conv(relu, at::randn({16, 16, 3, 3}), 1, 1), 16), "in place");
}

TEST(Plan, NoticesChangedWeights) {
  at::manual_seed(10);
  Builder b(8);
  const Slot a = b.relu(b.conv(b.graph.input, at::randn({16, 3, 3, 3}), 1, 1));
  const Graph graph = b.finish(b.conv(a, at::randn({16, 1, 3, 3}), 1, 1, 16), 16);
  const auto plan = compile_plan(graph, Precision::kFloat32, 1LL << 40);
  ASSERT_NE(plan, nullptr);
  MemoryMeter meter(1LL << 40, true);
  const at::NoGradGuard none;
  static_cast<void>(plan->logits(channels_last(at::rand({1, 3, 8, 8})), meter));
  EXPECT_TRUE(plan->weights_hold());
  for (const auto& [slot, tensor] : graph.constants) {
    if (tensor.dim() == 4) tensor.mul_(1.5);
  }
  EXPECT_FALSE(plan->weights_hold());
}

}  // namespace
}  // namespace tt3d::model
