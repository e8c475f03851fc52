#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>
#include <torch/csrc/autograd/custom_function.h>

#include <cmath>

#include "composite_math.h"
#include "field_kernels.h"
#include "half_mlp_op.h"
#include "march_math.h"
#include "tt3d/device.h"
#include "tt3d/field.h"
#include "tt3d/gpu_options.h"

// Checks, allocation, autograd and choice of the device. Among the room's kernels only this file
// and half_mlp_op.cpp include torch.
namespace tt3d::field {
namespace {

using at::Tensor;
using torch::autograd::AutogradContext;
using torch::autograd::Function;
using torch::autograd::variable_list;

std::vector<field::HashLevel> levels_of(const HashGridShape& shape) {
  std::vector<field::HashLevel> levels;
  const double growth =
      shape.levels > 1
          ? std::log(static_cast<double>(shape.finest) / static_cast<double>(shape.base)) /
                static_cast<double>(shape.levels - 1)
          : 0.0;
  int64_t offset = 0;
  for (int64_t l = 0; l < shape.levels; ++l) {
    const double scale =
        static_cast<double>(shape.base) * std::exp(growth * static_cast<double>(l));
    const auto resolution = static_cast<int64_t>(std::ceil(scale)) + 2;
    const int64_t points = resolution * resolution * resolution;
    const int64_t limit = int64_t{1} << shape.log2_size;
    const bool dense = points <= limit;
    const int64_t size = dense ? points : limit;
    levels.push_back({static_cast<float>(scale), static_cast<uint32_t>(resolution),
                      static_cast<uint32_t>(size), dense, offset});
    offset += size;
  }
  return levels;
}

/// The grid's levels as a kernel argument.
field::HashLevels kernel_levels(const HashGridShape& shape) {
  const auto list = levels_of(shape);
  field::HashLevels levels = {};
  levels.count = static_cast<int64_t>(list.size());
  std::copy(list.begin(), list.end(), levels.level);
  return levels;
}

struct HashEncode : public Function<HashEncode> {
  /// `points`: number of output rows before the encoding that hold the points themselves, 3 or 0.
  /// `moving`: the points require a gradient.
  static Tensor forward(AutogradContext* ctx, const Tensor& x_in, const Tensor& table,
                        const HashGridShape& shape, int64_t points, bool moving) {
    const Tensor x = x_in.contiguous();
    const int64_t count = x.size(0);
    Tensor out = at::empty({points + shape.levels * shape.features, count}, table.options());
    if (points > 0) out.narrow(0, 0, points).copy_(x.t());
    Tensor slopes;  // the GPU does not need them
    if (moving && !table.is_cuda()) {
      slopes = at::empty({shape.levels * shape.features, 3, count}, table.options());
    }
    const field::HashLevels levels = kernel_levels(shape);
    AT_DISPATCH_FLOATING_TYPES(table.scalar_type(), "hash_encode", [&] {
      on_device_of(table, [&](const auto& on) {
        field::hash_encode(on, x.const_data_ptr<scalar_t>(), table.const_data_ptr<scalar_t>(),
                           out.mutable_data_ptr<scalar_t>() + points * count,
                           slopes.defined() ? slopes.mutable_data_ptr<scalar_t>() : nullptr, count,
                           levels, shape.features);
      });
    });
    ctx->save_for_backward({x, table, slopes});
    ctx->saved_data["shape"] = std::vector<int64_t>{shape.levels,    shape.base,     shape.finest,
                                                    shape.log2_size, shape.features, points};
    return out;
  }
  static variable_list backward(AutogradContext* ctx, const variable_list& grads) {
    const variable_list saved = ctx->get_saved_variables();
    const Tensor &x = saved[0], &table = saved[1], &slopes = saved[2];
    const auto s = ctx->saved_data["shape"].toIntVector();
    const HashGridShape shape{s[0], s[1], s[2], s[3], s[4]};
    const field::HashLevels levels = kernel_levels(shape);
    const Tensor grad = grads[0].contiguous(), grad_points = grad.narrow(0, 0, s[5]);
    Tensor grad_x, grad_table;
    AT_DISPATCH_FLOATING_TYPES(table.scalar_type(), "hash_encode_backward", [&] {
      const auto* points = x.const_data_ptr<scalar_t>();
      const auto* g = grad.const_data_ptr<scalar_t>() + grad_points.numel();
      if (ctx->needs_input_grad(1)) {
        // The CPU clears each level just before it adds to it.
        grad_table = table.is_cuda() ? at::zeros_like(table) : at::empty_like(table);
        on_device_of(table, [&](const auto& on) {
          field::hash_encode_backward(on, points, g, grad_table.mutable_data_ptr<scalar_t>(),
                                      x.size(0), levels, shape.features);
        });
      }
      if (ctx->needs_input_grad(0)) {
        grad_x = at::empty_like(x);
        on_device_of(table, [&](const auto& on) {
          field::hash_encode_backward_points(
              on, points, table.const_data_ptr<scalar_t>(),
              slopes.defined() ? slopes.const_data_ptr<scalar_t>() : nullptr, g,
              grad_x.mutable_data_ptr<scalar_t>(), x.size(0), levels, shape.features);
        });
        if (grad_points.numel() > 0) grad_x += grad_points.t();
      }
    });
    return {grad_x, grad_table, Tensor(), Tensor(), Tensor()};
  }
};

template <typename T>
std::vector<field::Layer<T>> layers_of(const variable_list& weights) {
  std::vector<field::Layer<T>> layers;
  for (const Tensor& w : weights) layers.push_back({w.const_data_ptr<T>(), w.size(1), w.size(0)});
  return layers;
}

struct Mlp : public Function<Mlp> {
  static Tensor forward(AutogradContext* ctx, const Tensor& x_in, at::TensorList weights_in) {
    const Tensor x = x_in.contiguous();
    variable_list weights;
    for (const Tensor& w : weights_in) weights.push_back(w.contiguous());
    Tensor out = at::empty({weights.back().size(0), x.size(1)}, x.options());
    AT_DISPATCH_FLOATING_TYPES(x.scalar_type(), "mlp", [&] {
      field::mlp_cpu(x.const_data_ptr<scalar_t>(), layers_of<scalar_t>(weights),
                     out.mutable_data_ptr<scalar_t>(), x.size(1));
    });
    variable_list saved = {x};
    saved.insert(saved.end(), weights.begin(), weights.end());
    ctx->save_for_backward(saved);
    return out;
  }
  static variable_list backward(AutogradContext* ctx, const variable_list& grads) {
    const variable_list saved = ctx->get_saved_variables();
    const Tensor& x = saved[0];
    const variable_list weights(saved.begin() + 1, saved.end());
    const Tensor grad = grads[0].contiguous();
    Tensor grad_x;
    if (ctx->needs_input_grad(0)) grad_x = at::empty_like(x);
    variable_list results = {grad_x};
    for (const Tensor& w : weights) results.push_back(at::empty_like(w));
    AT_DISPATCH_FLOATING_TYPES(x.scalar_type(), "mlp_backward", [&] {
      std::vector<scalar_t*> grad_weights;
      for (size_t k = 1; k < results.size(); ++k) {
        grad_weights.push_back(results[k].mutable_data_ptr<scalar_t>());
      }
      field::mlp_backward_cpu(x.const_data_ptr<scalar_t>(), layers_of<scalar_t>(weights),
                              grad.const_data_ptr<scalar_t>(),
                              grad_x.defined() ? grad_x.mutable_data_ptr<scalar_t>() : nullptr,
                              grad_weights, x.size(1));
    });
    return results;
  }
};

struct Composite : public Function<Composite> {
  static Tensor forward(AutogradContext* ctx, const Tensor& densities_in, const Tensor& colors_in,
                        const Tensor& steps, const Tensor& ray_begin) {
    const Tensor densities = densities_in.contiguous(), colors = colors_in.contiguous();
    const int64_t rays = ray_begin.size(0) - 1;
    Tensor out = at::empty({rays, 4}, densities.options());
    AT_DISPATCH_FLOATING_TYPES(out.scalar_type(), "composite", [&] {
      const field::CompositeRay<scalar_t> body = {
          densities.const_data_ptr<scalar_t>(), colors.const_data_ptr<scalar_t>(),
          steps.const_data_ptr<scalar_t>(),     ray_begin.const_data_ptr<int64_t>(),
          out.mutable_data_ptr<scalar_t>(),     densities.size(0)};
      for_each_index_on(out, rays, body);
    });
    ctx->save_for_backward({densities, colors, steps, ray_begin});
    return out;
  }
  static variable_list backward(AutogradContext* ctx, const variable_list& grads) {
    const variable_list saved = ctx->get_saved_variables();
    const Tensor grad = grads[0].contiguous();
    Tensor grad_densities = at::zeros_like(saved[0]);
    Tensor grad_colors = at::zeros_like(saved[1]);
    AT_DISPATCH_FLOATING_TYPES(grad.scalar_type(), "composite_backward", [&] {
      const field::CompositeBackwardRay<scalar_t> body = {
          saved[0].const_data_ptr<scalar_t>(),      saved[1].const_data_ptr<scalar_t>(),
          saved[2].const_data_ptr<scalar_t>(),      saved[3].const_data_ptr<int64_t>(),
          grad.const_data_ptr<scalar_t>(),          grad_densities.mutable_data_ptr<scalar_t>(),
          grad_colors.mutable_data_ptr<scalar_t>(), saved[0].size(0)};
      for_each_index_on(grad, grad.size(0), body);
    });
    return {grad_densities, grad_colors, Tensor(), Tensor()};
  }
};

/// Whether any cell of each 8x8x8 block is occupied.
Tensor coarse_occupancy(const Tensor& occupied) {
  const int64_t size = occupied.size(0), coarse = size / field::kCoarse;
  TORCH_CHECK(size % field::kCoarse == 0 && occupied.is_contiguous(),
              "occupied must be dense [G,G,G] with G a multiple of 8");
  Tensor out = at::empty({coarse * coarse * coarse}, occupied.options());
  const field::CoarseCell body = {occupied.const_data_ptr<uint8_t>(),
                                  out.mutable_data_ptr<uint8_t>(), size};
  for_each_index_on(occupied, out.numel(), body);
  return out;
}

/// The float32 MLP of the GPU: one matrix product per layer; autograd differentiates them.
Tensor mlp_of_products(const Tensor& x, const std::vector<Tensor>& weights) {
  Tensor y = x;
  for (size_t k = 0; k < weights.size(); ++k) {
    y = at::mm(weights[k], y);
    if (k + 1 < weights.size()) y = y.relu_();
  }
  return y;
}

void check_hash_encode(const Tensor& x, const Tensor& table, const HashGridShape& shape) {
  TORCH_CHECK(x.dim() == 2 && x.size(1) == 3, "x must be [P,3]");
  TORCH_CHECK(shape.features == 1 || shape.features == 2, "features must be 1 or 2");
  TORCH_CHECK(shape.levels >= 1 && shape.levels <= field::HashLevels::kMaxLevels,
              "levels must be 1 to 32");
  check_same_device("hash_encode", {x, table});
  TORCH_CHECK(
      table.is_contiguous() && table.size(0) == shape.entries() && table.size(1) == shape.features,
      "table must be dense [entries, features]");
}

Tensor encode(const Tensor& x, const Tensor& table, const HashGridShape& shape, int64_t points) {
  check_hash_encode(x, table, shape);
  return HashEncode::apply(x, table, shape, points,
                           at::GradMode::is_enabled() && x.requires_grad());
}

}  // namespace

int64_t HashGridShape::entries() const {
  const auto levels_list = levels_of(*this);
  return levels_list.back().offset + levels_list.back().size;
}

Tensor hash_encode(const Tensor& x, const Tensor& table, const HashGridShape& shape) {
  return encode(x, table, shape, 0);
}

Tensor encode_points(const Tensor& x, const Tensor& table, const HashGridShape& shape) {
  return encode(x, table, shape, 3);
}

Tensor mlp(const Tensor& x, const std::vector<Tensor>& weights) {
  field::check_mlp("mlp", x, weights);
  if (!x.is_cuda()) return Mlp::apply(x, at::TensorList(weights));
  if (gpu_options().half_mlp && field::half_mlp_fits(weights)) return half_mlp(x, weights);
  return mlp_of_products(x, weights);
}

Tensor composite(const Tensor& densities, const Tensor& colors, const Tensor& steps,
                 const Tensor& ray_begin) {
  TORCH_CHECK(colors.dim() == 2 && colors.size(0) == 3 && colors.size(1) == densities.size(0),
              "colors must be [3,S]");
  check_same_device("composite", {densities, colors, steps, ray_begin});
  return Composite::apply(densities, colors, steps.contiguous(), ray_begin);
}

RaySamples march_rays(const Tensor& origins, const Tensor& directions, const Tensor& occupied,
                      const Tensor& jitter, double step, double near_distance) {
  check_same_device("march_rays", {origins, directions, occupied, jitter});
  const int64_t rays = origins.size(0);
  const Tensor coarse = coarse_occupancy(occupied);
  const field::MarchRays input = {
      origins.const_data_ptr<float>(), directions.const_data_ptr<float>(),
      jitter.const_data_ptr<float>(),
      field::MarchGrid{occupied.const_data_ptr<uint8_t>(), coarse.const_data_ptr<uint8_t>(),
                       occupied.size(0), static_cast<float>(step),
                       static_cast<float>(near_distance)}};
  Tensor begin = at::zeros({rays + 1}, origins.options().dtype(at::kLong));
  for_each_index_on(origins, rays, field::CountSamples{input, begin.mutable_data_ptr<int64_t>()});
  const int64_t total = counts_to_begins(begin);
  Tensor points = at::empty({total, 3}, origins.options());
  for_each_index_on(origins, rays,
                    field::WriteSamples{input, begin.const_data_ptr<int64_t>(),
                                        points.mutable_data_ptr<float>()});
  return {points, at::full({total}, step, origins.options()), begin};
}

std::pair<Tensor, Tensor> visible_samples(const Tensor& densities, const Tensor& steps,
                                          const Tensor& ray_begin, double threshold) {
  check_same_device("visible_samples", {densities, steps, ray_begin});
  const int64_t rays = ray_begin.size(0) - 1;
  const auto* first = ray_begin.const_data_ptr<int64_t>();
  Tensor begin = at::zeros({rays + 1}, ray_begin.options());
  for_each_index_on(
      densities, rays,
      field::CountVisible{densities.const_data_ptr<float>(), steps.const_data_ptr<float>(), first,
                          -std::log(threshold), begin.mutable_data_ptr<int64_t>()});
  const int64_t total = counts_to_begins(begin);
  Tensor kept = at::empty({total}, ray_begin.options());
  for_each_index_on(
      densities, rays,
      field::WriteFirst{first, begin.const_data_ptr<int64_t>(), kept.mutable_data_ptr<int64_t>()});
  return {kept, begin};
}

}  // namespace tt3d::field
