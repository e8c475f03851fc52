#include "half_mlp_op.h"

#include <ATen/ATen.h>
#include <torch/csrc/autograd/custom_function.h>

#include <cmath>
#include <type_traits>
#include <utility>

#include "half_mlp_math.h"
#include "tt3d/device.h"
#include "tt3d/field.h"

// The MLPs in half precision: checks, allocation, scaling of the gradients, autograd.
namespace tt3d::field {
namespace {

using at::Tensor;
using torch::autograd::AutogradContext;
using torch::autograd::Function;
using torch::autograd::variable_list;

/// Describes the network for the half-precision loops; false if it is too wide or too deep for
/// them.
bool network_of(const variable_list& weights, HalfNetwork& net) {
  if (weights.size() > kMaxHalfLayers) return false;
  net.count = static_cast<int>(weights.size());
  for (size_t k = 0; k < weights.size(); ++k) {
    const Tensor& w = weights[k];
    constexpr int64_t kWidest = kMaxTiles * kTile;
    if (w.scalar_type() != at::kFloat || w.size(0) > kWidest || w.size(1) > kWidest) return false;
    net.layer[k] = {w.const_data_ptr<float>(), static_cast<int>(w.size(1)),
                    static_cast<int>(w.size(0))};
  }
  return true;
}

template <typename Executor>
int64_t teams_for(const Executor& on, int64_t points) {
  return std::min((points + team_points(on) - 1) / team_points(on), kMaxTeams);
}

template <typename Body, int... kDepth>
void with_depth(int layers, const Body& body, std::integer_sequence<int, kDepth...> /*depths*/) {
  ((layers == kDepth + 1 ? body(std::integral_constant<int, kDepth + 1>()) : void()), ...);
}

/// Calls `body` with the number of layers as a constant.
template <typename Body>
void with_depth(int layers, const Body& body) {
  with_depth(layers, body, std::make_integer_sequence<int, kMaxHalfLayers>());
}

/// Extracts the weights' gradients from their sums, which are stored tile by tile.
variable_list weight_gradients(const Tensor& sums, const variable_list& weights) {
  variable_list gradients;
  int64_t begin = 0;
  for (const Tensor& w : weights) {
    const int64_t rows = tiles_of(static_cast<int>(w.size(0)));
    const int64_t columns = tiles_of(static_cast<int>(w.size(1)));
    const int64_t numbers = rows * columns * kTile * kTile;
    gradients.push_back(sums.narrow(0, begin, numbers)
                            .view({rows, columns, kTile, kTile})
                            .transpose(1, 2)
                            .reshape({rows * kTile, columns * kTile})
                            .slice(0, 0, w.size(0))
                            .slice(1, 0, w.size(1)));
    begin += numbers;
  }
  return gradients;
}

struct HalfMlp : public Function<HalfMlp> {
  static Tensor forward(AutogradContext* ctx, const Tensor& x_in, at::TensorList weights_in) {
    const Tensor x = x_in.contiguous();
    variable_list saved = {x};
    for (const Tensor& w : weights_in) saved.push_back(w.contiguous());
    const variable_list weights(saved.begin() + 1, saved.end());
    HalfNetwork net;
    TORCH_CHECK(network_of(weights, net), "half_mlp: too wide, or not float32");
    const int64_t count = x.size(1);
    Tensor out = at::empty({weights.back().size(0), count}, x.options());
    if (count > 0) {
      with_depth(net.count, [&](auto layers) {
        const HalfForward<decltype(layers)::value> share = {net, x.const_data_ptr<float>(),
                                                            out.mutable_data_ptr<float>(), count};
        on_device_of(x, [&](const auto& on) { run_teams(on, teams_for(on, count), share); });
      });
    }
    ctx->save_for_backward(saved);
    return out;
  }
  static variable_list backward(AutogradContext* ctx, const variable_list& grads) {
    const variable_list saved = ctx->get_saved_variables();
    const Tensor& x = saved[0];
    const variable_list weights(saved.begin() + 1, saved.end());
    const int64_t count = x.size(1);
    HalfNetwork net = {};
    network_of(weights, net);
    Tensor grad_x;
    if (ctx->needs_input_grad(0)) grad_x = at::empty_like(x);
    variable_list results = {grad_x};
    Tensor sums;
    if (count == 0) {
      sums = at::zeros({net.sums()}, x.options());
    } else {
      const Tensor grad = grads[0].contiguous();
      const Tensor largest = at::linalg_vector_norm(grad, INFINITY);
      with_depth(net.count, [&](auto layers) {
        on_device_of(x, [&](const auto& on) {
          const Tensor of_teams = at::empty({teams_for(on, count), net.sums()}, x.options());
          const HalfBackward<decltype(layers)::value> share = {
              net,
              x.const_data_ptr<float>(),
              grad.const_data_ptr<float>(),
              largest.const_data_ptr<float>(),
              grad_x.defined() ? grad_x.mutable_data_ptr<float>() : nullptr,
              of_teams.mutable_data_ptr<float>(),
              count};
          run_teams(on, of_teams.size(0), share);
          sums = of_teams.sum(0);
        });
      });
    }
    for (Tensor& g : weight_gradients(sums, weights)) results.push_back(std::move(g));
    return results;
  }
};

}  // namespace

void check_mlp(const char* name, const Tensor& x, const std::vector<Tensor>& weights) {
  TORCH_CHECK(!weights.empty() && x.dim() == 2 && x.size(0) == weights[0].size(1), name,
              ": x must be [I,P] with I the first layer's inputs");
  for (const Tensor& w : weights) check_same_device(name, {x, w});
}

bool half_mlp_fits(const std::vector<Tensor>& weights) {
  HalfNetwork net;
  return network_of(weights, net);
}

}  // namespace tt3d::field

namespace tt3d::field {

at::Tensor half_mlp(const at::Tensor& x, const std::vector<at::Tensor>& weights) {
  field::check_mlp("half_mlp", x, weights);
  return field::HalfMlp::apply(x, at::TensorList(weights));
}

}  // namespace tt3d::field
