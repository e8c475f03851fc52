#include "tt3d/image.h"

#include <ATen/ATen.h>
#include <torch/csrc/autograd/custom_function.h>

#include "ssim_cpu.h"
#include "ssim_math.h"

namespace tt3d::image {
namespace {

using at::Tensor;
using torch::autograd::AutogradContext;
using torch::autograd::Function;
using torch::autograd::variable_list;

similarity::Sizes sizes_of(const Tensor& planes, int64_t stride) {
  return {planes.size(0), planes.size(1), planes.size(2), stride};
}

/// Mean similarity [P] over the windows of planes x, y [P,H,W]; differentiable in x.
struct PlaneSimilarity : public Function<PlaneSimilarity> {
  static Tensor forward(AutogradContext* ctx, const Tensor& x, const Tensor& y, int64_t stride) {
    const similarity::Sizes s = sizes_of(x, stride);
    const bool wanted = x.requires_grad();
    const Tensor mean = at::empty({s.planes}, x.options());
    const Tensor slopes =
        at::empty({wanted ? s.planes : 0, s.window_rows(), 3, s.window_columns()}, x.options());
    AT_DISPATCH_FLOATING_TYPES(x.scalar_type(), "structural_similarity", [&] {
      similarity::mean_cpu(x.const_data_ptr<scalar_t>(), y.const_data_ptr<scalar_t>(),
                           mean.mutable_data_ptr<scalar_t>(),
                           wanted ? slopes.mutable_data_ptr<scalar_t>() : nullptr, s);
    });
    ctx->save_for_backward({x, y, slopes});
    ctx->saved_data["stride"] = stride;
    return mean;
  }
  static variable_list backward(AutogradContext* ctx, const variable_list& grads) {
    const variable_list saved = ctx->get_saved_variables();
    const Tensor &x = saved[0], &y = saved[1], &slopes = saved[2];
    const Tensor grad = grads[0].contiguous(), grad_x = at::empty_like(x);
    AT_DISPATCH_FLOATING_TYPES(x.scalar_type(), "structural_similarity_backward", [&] {
      similarity::gradient_cpu(x.const_data_ptr<scalar_t>(), y.const_data_ptr<scalar_t>(),
                               slopes.const_data_ptr<scalar_t>(), grad.const_data_ptr<scalar_t>(),
                               grad_x.mutable_data_ptr<scalar_t>(),
                               sizes_of(x, ctx->saved_data["stride"].toInt()));
    });
    return {grad_x, Tensor(), Tensor()};
  }
};

/// On the GPU, torch's convolutions are as fast as a kernel of our own.
Tensor similarity_of_convolutions(const Tensor& planes_x, const Tensor& planes_y, int64_t stride) {
  const Tensor offsets = at::arange(similarity::kTaps, planes_x.options()) - similarity::kTaps / 2;
  Tensor kernel = (-(offsets.square()) / (2 * similarity::kSigma * similarity::kSigma)).exp();
  kernel = kernel / kernel.sum();
  const Tensor x = planes_x.unsqueeze(1), y = planes_y.unsqueeze(1);
  // All five inputs of the window in one batch: [5 P,1,H,W].
  const Tensor all = at::cat({x, y, x * x, y * y, x * y});
  const Tensor rows = at::conv2d(all, kernel.view({1, 1, 1, -1}), {}, {1, stride});
  const auto m = at::conv2d(rows, kernel.view({1, 1, -1, 1}), {}, {stride, 1}).chunk(5);
  const Tensor &mx = m[0], &my = m[1];
  const Tensor vx = m[2] - mx * mx, vy = m[3] - my * my, cov = m[4] - mx * my;
  const Tensor map = ((2 * mx * my + similarity::kC1) * (2 * cov + similarity::kC2)) /
                     ((mx * mx + my * my + similarity::kC1) * (vx + vy + similarity::kC2));
  return map.mean({1, 2, 3});
}

}  // namespace

Tensor structural_similarity(const Tensor& a, const Tensor& b, int64_t stride) {
  const int64_t n = a.size(0), height = a.size(2), width = a.size(3);
  TORCH_CHECK(height >= similarity::kTaps && width >= similarity::kTaps && stride > 0,
              "pictures must have at least ", similarity::kTaps, " pixels a side");
  const Tensor x = a.reshape({-1, height, width}).contiguous();
  const Tensor y = b.detach().reshape({-1, height, width}).contiguous();
  const Tensor planes =
      x.is_cpu() ? PlaneSimilarity::apply(x, y, stride) : similarity_of_convolutions(x, y, stride);
  return planes.view({n, -1}).mean(1);
}

}  // namespace tt3d::image
