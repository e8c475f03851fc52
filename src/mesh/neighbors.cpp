#include "neighbors.h"

#include <ATen/ATen.h>
#include <torch/csrc/autograd/custom_function.h>

#include <algorithm>

#include "neighbor_math.h"
#include "tt3d/device.h"

namespace tt3d::mesh {
namespace {

using at::Tensor;
using torch::autograd::AutogradContext;
using torch::autograd::Function;
using torch::autograd::variable_list;
using Held = std::shared_ptr<const Neighbors>;

template <typename T>
NeighborLists<T> lists_of(const Neighbors& n, bool weighted) {
  return {n.begin.const_data_ptr<int64_t>(), n.vertex.const_data_ptr<int32_t>(),
          weighted && n.weight.defined() ? n.weight.const_data_ptr<T>() : nullptr};
}

Tensor differences(const Tensor& x_in, const Neighbors& n, bool weighted) {
  const Tensor x = x_in.contiguous();
  Tensor out = at::empty_like(x);
  AT_DISPATCH_FLOATING_TYPES(x.scalar_type(), "neighbor_differences", [&] {
    const NeighborDifferences<scalar_t> body = {lists_of<scalar_t>(n, weighted),
                                                x.const_data_ptr<scalar_t>(),
                                                out.mutable_data_ptr<scalar_t>()};
    for_each_index_on(x, x.size(0), body);
  });
  return out;
}

/// Data for the backward pass besides tensors.
struct HeldNeighbors : torch::CustomClassHolder {
  explicit HeldNeighbors(Held held) : neighbors(std::move(held)) {}
  Held neighbors;
};

void hold(AutogradContext* ctx, const Held& neighbors) {
  ctx->saved_data["neighbors"] =
      c10::IValue::make_capsule(c10::make_intrusive<HeldNeighbors>(neighbors));
}

Held held_by(AutogradContext* ctx) {
  const auto capsule = ctx->saved_data["neighbors"].toCapsule();
  return static_cast<HeldNeighbors&>(*capsule).neighbors;
}

struct Differences : public Function<Differences> {
  static Tensor forward(AutogradContext* ctx, const Tensor& x, const Held& neighbors) {
    hold(ctx, neighbors);
    return differences(x, *neighbors, true);
  }
  static variable_list backward(AutogradContext* ctx, const variable_list& grads) {
    return {differences(grads[0], *held_by(ctx), true), Tensor()};
  }
};

struct MeanSquaredEdge : public Function<MeanSquaredEdge> {
  static Tensor forward(AutogradContext* ctx, const Tensor& x_in, const Held& neighbors) {
    const Tensor x = x_in.contiguous();
    ctx->save_for_backward({x});
    hold(ctx, neighbors);
    Tensor squares = at::empty({x.size(0)}, x.options());
    AT_DISPATCH_FLOATING_TYPES(x.scalar_type(), "mean_squared_edge", [&] {
      const NeighborDistances<scalar_t> body = {lists_of<scalar_t>(*neighbors, false),
                                                x.const_data_ptr<scalar_t>(),
                                                squares.mutable_data_ptr<scalar_t>()};
      for_each_index_on(x, x.size(0), body);
    });
    return squares.sum() / static_cast<double>(2 * neighbors->edges());  // each is counted twice
  }
  static variable_list backward(AutogradContext* ctx, const variable_list& grads) {
    const Held neighbors = held_by(ctx);
    const Tensor slope = differences(ctx->get_saved_variables()[0], *neighbors, false);
    return {slope * (grads[0] * (2 / static_cast<double>(neighbors->edges()))), Tensor()};
  }
};

}  // namespace

Neighbors::Neighbors(const Tensor& edges, const Tensor& weights, int64_t vertices,
                     const at::TensorOptions& like) {
  // Both directions of every edge, ordered by start vertex, then by edge.
  const Tensor from = at::cat({edges.select(1, 0), edges.select(1, 1)});
  const Tensor to = at::cat({edges.select(1, 1), edges.select(1, 0)});
  const Tensor order = at::argsort(from, /*stable=*/true, 0, false);
  const Tensor counts = at::bincount(from, {}, vertices);
  begin = at::cat({at::zeros({1}, counts.options()), counts.cumsum(0)}).to(like.device());
  vertex = to.index_select(0, order).to(at::kInt).to(like.device());
  if (weights.defined()) {
    weight = at::cat({weights, weights}).index_select(0, order).to(like).contiguous();
  }
}

Tensor neighbor_differences(const Tensor& x, const Held& neighbors) {
  return Differences::apply(x, neighbors);
}

Tensor mean_squared_edge(const Tensor& x, const Held& neighbors) {
  return MeanSquaredEdge::apply(x, neighbors);
}

}  // namespace tt3d::mesh
