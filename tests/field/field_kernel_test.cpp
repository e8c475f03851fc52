#include <gtest/gtest.h>

#include <cmath>

#include "field/field_reference.h"
#include "support/gradient_check.h"
#include "support/shapes.h"
#include "tt3d/field.h"
#include "tt3d/optimize.h"

namespace tt3d::field {
namespace {

using at::Tensor;
using testing::gradient_error;
using testing::reference_encode;
using testing::uniform;

/// Small enough to have both dense and hashed levels.
HashGridShape small_shape(int64_t features) { return {4, 4, 40, 9, features}; }

TEST(HashEncode, EqualsTheTensorReference) {
  for (const int64_t features : {1, 2}) {
    const HashGridShape shape = small_shape(features);
    Tensor x = uniform({333, 3}, -1, 1, 1);
    x[0].fill_(1);
    x[1].fill_(-1);
    x[2].fill_(1.5);
    const Tensor table = uniform({shape.entries(), features}, -1, 1, 2);
    const Tensor expected = reference_encode(x, table, shape);
    EXPECT_LT((hash_encode(x, table, shape) - expected).abs().max().item<double>(), 1e-12);
    const Tensor in_float = hash_encode(x.to(at::kFloat), table.to(at::kFloat), shape);
    EXPECT_LT((in_float.to(at::kDouble) - expected).abs().max().item<double>(), 1e-4);
  }
}

TEST(HashEncode, GradientsAgainstTensorReferenceAndCentralDifferences) {
  const HashGridShape shape = small_shape(2);
  const Tensor weight = uniform({8, 50}, -1, 1, 3);
  const Tensor x0 = uniform({50, 3}, -0.95, 0.95, 4);
  const Tensor table0 = uniform({shape.entries(), 2}, -1, 1, 5);
  Tensor x = x0.clone().requires_grad_(true), table = table0.clone().requires_grad_(true);
  Tensor xr = x0.clone().requires_grad_(true), table_r = table0.clone().requires_grad_(true);
  (hash_encode(x, table, shape).square() * weight).sum().backward();
  (reference_encode(xr, table_r, shape).square() * weight).sum().backward();
  EXPECT_LT((table.grad() - table_r.grad()).abs().max().item<double>(), 1e-10);
  EXPECT_LT((x.grad() - xr.grad()).abs().max().item<double>(), 1e-9);
  const auto loss = [&](const std::vector<Tensor>& in) {
    return (hash_encode(in[0], in[1], shape).square() * weight.narrow(1, 0, 6)).sum();
  };
  EXPECT_LT(gradient_error(loss, {x0.narrow(0, 0, 6), table0}, 1e-7), 1e-5);
}

TEST(HashEncode, PointsStackOnTheirEncoding) {
  const HashGridShape shape = small_shape(2);
  const Tensor x0 = uniform({50, 3}, -0.95, 0.95, 4);
  const Tensor table0 = uniform({shape.entries(), 2}, -1, 1, 5);
  const Tensor weight = uniform({11, 50}, -1, 1, 3);
  std::vector<Tensor> results;
  for (const bool fused : {true, false}) {
    const Tensor x = x0.clone().requires_grad_(true), table = table0.clone().requires_grad_(true);
    const Tensor y =
        fused ? encode_points(x, table, shape) : at::cat({x.t(), hash_encode(x, table, shape)}, 0);
    (y * weight).sum().backward();
    results.insert(results.end(), {y.detach(), x.grad(), table.grad()});
  }
  for (size_t i = 0; i < 3; ++i) EXPECT_TRUE(at::equal(results[i], results[i + 3])) << i;
}

Tensor reference_mlp(Tensor x, const std::vector<Tensor>& weights) {
  for (size_t k = 0; k < weights.size(); ++k) {
    x = weights[k].matmul(x);
    if (k + 1 < weights.size()) x = x.relu();
  }
  return x;
}

TEST(Mlp, ForwardAndGradientsEqualTheTensorReference) {
  for (const int64_t count : {1, 127, 128, 1000, 9000}) {
    const std::vector<Tensor> w0 = {uniform({19, 7}, -1, 1, 6), uniform({13, 19}, -1, 1, 7),
                                    uniform({3, 13}, -1, 1, 8)};
    const Tensor x0 = uniform({7, count}, -1, 1, 9);
    const Tensor weight = uniform({3, count}, -1, 1, 10);
    std::vector<Tensor> a = {x0.clone()}, b = {x0.clone()};
    for (const Tensor& w : w0) {
      a.push_back(w.clone());
      b.push_back(w.clone());
    }
    for (auto* list : {&a, &b}) {
      for (Tensor& t : *list) t.requires_grad_(true);
    }
    const Tensor ya = mlp(a[0], {a[1], a[2], a[3]});
    const Tensor yb = reference_mlp(b[0], {b[1], b[2], b[3]});
    EXPECT_LT((ya - yb).abs().max().item<double>(), 1e-11);
    (ya * weight).sum().backward();
    (yb * weight).sum().backward();
    for (size_t i = 0; i < a.size(); ++i) {
      EXPECT_LT((a[i].grad() - b[i].grad()).abs().max().item<double>(), 1e-9) << i;
    }
  }
}

TEST(Mlp, GradientAgainstCentralDifferences) {
  const auto loss = [](const std::vector<Tensor>& in) {
    return mlp(in[0], {in[1], in[2]}).square().sum();
  };
  EXPECT_LT(gradient_error(loss, {uniform({5, 20}, -1, 1, 11), uniform({6, 5}, -1, 1, 12),
                                  uniform({2, 6}, -1, 1, 13)}),
            1e-6);
}

/// Volume rendering in plain tensor operations, one ray at a time.
Tensor reference_composite(const Tensor& densities, const Tensor& colors, const Tensor& steps,
                           const std::vector<int64_t>& begin) {
  std::vector<Tensor> rays;
  for (size_t r = 0; r + 1 < begin.size(); ++r) {
    const int64_t n = begin[r + 1] - begin[r];
    const Tensor depth = densities.narrow(0, begin[r], n) * steps.narrow(0, begin[r], n);
    const Tensor before = at::cumsum(depth, 0) - depth;
    const Tensor weight = at::exp(-before) * (1 - at::exp(-depth));
    rays.push_back(at::cat({(colors.narrow(1, begin[r], n) * weight).sum(1), weight.sum(0, true)}));
  }
  return at::stack(rays);
}

TEST(Composite, ValuesAndGradients) {
  const std::vector<int64_t> begin = {0, 3, 3, 10};
  const Tensor ray_begin = at::tensor(begin, at::kLong);
  const Tensor densities = uniform({10}, 0, 3, 14), colors = uniform({3, 10}, 0, 1, 15);
  const Tensor steps = uniform({10}, 0.1, 0.3, 16);
  const Tensor out = composite(densities, colors, steps, ray_begin);
  const Tensor expected = reference_composite(densities, colors, steps, begin);
  EXPECT_LT((out - expected).abs().max().item<double>(), 1e-12);
  const Tensor weight = uniform({3, 4}, -1, 1, 17);
  const auto loss = [&](const std::vector<Tensor>& in) {
    return (composite(in[0], in[1], steps, ray_begin).square() * weight).sum();
  };
  EXPECT_LT(gradient_error(loss, {densities, colors}), 1e-6);
}

TEST(Composite, UniformMediumHasItsAnalyticTransmittance) {
  const Tensor densities = at::full({1000}, 2.0, at::kDouble);
  const Tensor steps = at::full({1000}, 1e-3, at::kDouble);
  const Tensor out = composite(densities, at::ones({3, 1000}, at::kDouble), steps,
                               at::tensor({0, 1000}, at::kLong));
  EXPECT_NEAR(out[0][3].item<double>(), 1 - std::exp(-2.0), 1e-9);
}

TEST(MarchRays, SamplesLieInOccupiedCellsOnly) {
  Tensor occupied = at::zeros({8, 8, 8}, at::kByte);
  occupied[3][4][5] = 1;  // z, y, x
  const Tensor origins = at::tensor({-3.F, 0.125F, -0.125F}).view({1, 3});
  const Tensor directions = at::tensor({1.F, 0.F, 0.F}).view({1, 3});
  const RaySamples s = march_rays(origins, directions, occupied, at::zeros({1}), 0.01, 0.05);
  // The cell spans x in [0.25, 0.5): 25 steps of 0.01.
  EXPECT_NEAR(double(s.points.size(0)), 25, 1);
  EXPECT_GE(s.points.select(1, 0).min().item<float>(), 0.25F - 1e-4F);
  EXPECT_LE(s.points.select(1, 0).max().item<float>(), 0.5F + 1e-4F);
}

TEST(MarchRays, EmptyGridAndMissedBoxGiveNothing) {
  const Tensor origins = at::tensor({-3.F, 0.F, 0.F, -3.F, 5.F, 0.F}).view({2, 3});
  const Tensor directions = at::tensor({1.F, 0.F, 0.F, 1.F, 0.F, 0.F}).view({2, 3});
  const Tensor none = at::zeros({8, 8, 8}, at::kByte), all = at::ones({8, 8, 8}, at::kByte);
  EXPECT_EQ(march_rays(origins, directions, none, at::zeros({2}), 0.01, 0.05).points.size(0), 0);
  const RaySamples s = march_rays(origins, directions, all, at::zeros({2}), 0.01, 0.05);
  EXPECT_NEAR(s.ray_begin[1].item<double>(), 200, 2);
  EXPECT_EQ(s.ray_begin[2].item<int64_t>(), s.ray_begin[1].item<int64_t>());
}

TEST(VisibleSamples, StopsBehindTheThreshold) {
  const Tensor densities = at::tensor({0.F, 100.F, 100.F, 1.F, 1.F});
  const auto [kept, begin] =
      visible_samples(densities, at::full({5}, 0.1F), at::tensor({0, 3, 5}, at::kLong), 1e-3);
  EXPECT_TRUE(at::equal(kept, at::tensor({0, 1, 3, 4}, at::kLong)));
  EXPECT_TRUE(at::equal(begin, at::tensor({0, 2, 4}, at::kLong)));
}

TEST(FieldKernels, SameBytesWithOneAndTwoThreads) {
  const HashGridShape shape = small_shape(2);
  const int before = at::get_num_threads();
  std::vector<Tensor> results;
  for (const int threads : {1, 2}) {
    at::set_num_threads(threads);
    Tensor x = uniform({20000, 3}, -1, 1, 1).to(at::kFloat).requires_grad_(true);
    Tensor table = uniform({shape.entries(), 2}, -1, 1, 2).to(at::kFloat).requires_grad_(true);
    Tensor w = uniform({5, 8}, -1, 1, 3).to(at::kFloat).requires_grad_(true);
    const Tensor y = mlp(hash_encode(x, table, shape), {w});
    const Tensor grad = at::ones_like(y);
    y.backward(grad);
    results.push_back(at::cat(
        {y.detach().flatten(), x.grad().flatten(), table.grad().flatten(), w.grad().flatten()}));
  }
  at::set_num_threads(before);
  EXPECT_TRUE(at::equal(results[0], results[1]));
}

TEST(Adam, FirstStepMovesByTheRateAndUntouchedEntriesStay) {
  const Tensor p = at::tensor({1.F, 1.F}), g = at::tensor({0.5F, 0.F});
  const Tensor m = at::zeros({2}), v = at::zeros({2});
  optimize::Adam{}.step(p, g, m, v, 0.1, 1);
  EXPECT_NEAR(p[0].item<float>(), 0.9F, 1e-5);
  EXPECT_EQ(p[1].item<float>(), 1.F);
}

}  // namespace
}  // namespace tt3d::field
