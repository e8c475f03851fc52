#include <ATen/ATen.h>
#include <torch/csrc/autograd/custom_function.h>

#include "project_math.h"
#include "tt3d/device.h"
#include "tt3d/scene.h"

namespace tt3d::scene {
namespace {

using at::Tensor;
using torch::autograd::AutogradContext;
using torch::autograd::Function;
using torch::autograd::variable_list;

/// A kernel of its own: general matrix libraries take ten times as long for four columns.
struct ToClip : public Function<ToClip> {
  static Tensor forward(AutogradContext* ctx, const Tensor& points_in, const Tensor& matrices_in) {
    const Tensor points = points_in.contiguous(), matrices = matrices_in.contiguous();
    const int64_t views = matrices.size(0), vertices = points.size(0);
    Tensor clip = at::empty({views, vertices, 4}, points.options());
    AT_DISPATCH_FLOATING_TYPES(points.scalar_type(), "to_clip", [&] {
      const ProjectVertex<scalar_t> body = {points.const_data_ptr<scalar_t>(),
                                            matrices.const_data_ptr<scalar_t>(),
                                            clip.mutable_data_ptr<scalar_t>(), vertices};
      for_each_index_on(points, views * vertices, body);
    });
    ctx->save_for_backward({matrices});
    return clip;
  }
  static variable_list backward(AutogradContext* ctx, const variable_list& grads) {
    const Tensor matrices = ctx->get_saved_variables()[0], grad = grads[0].contiguous();
    const int64_t views = grad.size(0), vertices = grad.size(1);
    Tensor grad_points = at::empty({vertices, 3}, grad.options());
    AT_DISPATCH_FLOATING_TYPES(grad.scalar_type(), "to_clip_backward", [&] {
      const ProjectBackwardVertex<scalar_t> body = {
          grad.const_data_ptr<scalar_t>(), matrices.const_data_ptr<scalar_t>(),
          grad_points.mutable_data_ptr<scalar_t>(), views, vertices};
      for_each_index_on(grad, vertices, body);
    });
    return {grad_points, Tensor()};
  }
};

}  // namespace

Tensor to_clip(const Tensor& vertices, const Tensor& matrices) {
  TORCH_CHECK(vertices.dim() == 2 && vertices.size(1) == 3, "vertices must be [V,3]");
  TORCH_CHECK(matrices.dim() == 3 && matrices.size(1) == 4 && matrices.size(2) == 4 &&
                  matrices.scalar_type() == vertices.scalar_type(),
              "matrices must be [N,4,4], of the vertices' type");
  check_same_device("to_clip", {vertices, matrices});
  return ToClip::apply(vertices, matrices);
}

}  // namespace tt3d::scene
