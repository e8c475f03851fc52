#include "object_terms.h"

#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>
#include <torch/csrc/autograd/autograd.h>

#include <algorithm>
#include <utility>

#include "color_space.h"
#include "picture_ops.h"

namespace tt3d::attack {
namespace {

using at::Tensor;

/// Copies the figures of the step to the host in one transfer. `hits`: the success on each
/// surrogate that ran.
record::CurvePoint curve_point(int64_t step, std::vector<Tensor> figures,
                               const std::vector<Tensor>& hits) {
  figures.insert(figures.end(), hits.begin(), hits.end());
  for (Tensor& f : figures) f = f.detach().to(at::kDouble);
  const Tensor on_host = at::stack(figures).cpu();
  const auto* f = on_host.const_data_ptr<double>();
  double success = 0;
  for (size_t m = 0; m < hits.size(); ++m) success += f[6 + m] / static_cast<double>(hits.size());
  return {step, f[0], f[1], f[2], f[3], f[4], f[5], success};
}

}  // namespace

ObjectTerms::ObjectTerms(const AttackInput& input, const AttackOptions& options, uint64_t seed)
    : input_(input),
      options_(options),
      seed_(seed),
      views_(options.schedule.views_per_step),
      ensemble_(input, options, seed),
      naturalness_(input, options),
      prepared_(input.object.mesh.faces) {}

record::CurvePoint ObjectTerms::compute(const object::Appearance& appearance, const Tensor& offsets,
                                        int64_t step, const std::vector<Tensor>& parameters,
                                        std::vector<Tensor>& grads) const {
  const Tensor vertices = input_.object.mesh.vertices + offsets;
  const Rendering shown = render(appearance, vertices, step);
  std::vector<Tensor> hits;
  const Tensor lit = light_pictures(shown.pictures, shown.normals, options_.eot, seed_, step);
  // attack.feature_mix mixes in the clean object in the same views.
  const Tensor competitors = options_.objective.feature_mix > 0 ? shown.clean.detach() : Tensor();
  const Tensor objective = ensemble_.loss(lit, competitors, step, hits);
  const Naturalness::Terms natural = naturalness_.terms(shown, vertices);
  const Tensor loss = objective + options_.naturalness.beta * natural.total;
  grads = torch::autograd::grad({loss}, parameters);
  return curve_point(
      step, {loss, objective, shown.rgb, natural.chamfer, natural.laplacian, natural.edge}, hits);
}

std::vector<scene::Camera> ObjectTerms::cameras(int64_t step) const {
  auto sampled = scene::cameras_of(
      scene::sample_views(options_.schedule.view_distribution, seed_, step * views_, views_,
                          static_cast<int>(options_.schedule.image_size), input_.frame));
  return shift_object(std::move(sampled), input_.frame.radius, options_.eot, seed_, step);
}

double ObjectTerms::held_out_success(const object::Appearance& appearance,
                                     const Tensor& offsets) const {
  constexpr uint64_t kHeldOut = 0x0E90C4ULL;  // a stream apart from those of training and
                                              // evaluation
  at::NoGradGuard guard;
  const ScheduleOptions& schedule = options_.schedule;
  const Tensor& rest = input_.object.mesh.vertices;
  double sum = 0;
  for (int64_t first = 0; first < schedule.held_out_views; first += views_) {
    const int64_t count = std::min(views_, schedule.held_out_views - first);
    const auto cameras = scene::cameras_of(
        scene::sample_views(schedule.view_distribution, seed_ ^ kHeldOut, first, count,
                            static_cast<int>(schedule.image_size), input_.frame));
    const Tensor shown = mesh::render_mesh(rest + offsets, rest, prepared_, cameras,
                                           [&](const raster::SurfacePoints& points) {
                                             return appearance.color(points);
                                           })
                             .permute({0, 3, 1, 2});
    sum += ensemble_.success(over_white(shown).clamp(0, 1)) * static_cast<double>(count);
  }
  return sum / static_cast<double>(schedule.held_out_views);
}

/// Renders the views of the step. The colours, and the clean colours and normals if they are
/// needed, are channels of one picture.
Rendering ObjectTerms::render(const object::Appearance& appearance, const Tensor& vertices,
                              int64_t step) const {
  const int64_t size = options_.schedule.image_size;
  const auto pixels = static_cast<double>(3 * views_ * size * size);
  const bool with_clean = naturalness_.compares_pictures() || options_.objective.feature_mix > 0;
  const bool with_normals = options_.eot.light > 0;
  Rendering shown;
  // The appearance is looked up at the rest positions, so it moves with the surface.
  const Tensor rendered = mesh::render_mesh(
      vertices, input_.object.mesh.vertices, prepared_, cameras(step),
      [&](const raster::SurfacePoints& points) {
        shown.colors = appearance.color(points);
        Tensor clean;
        {
          at::NoGradGuard guard;
          clean =
              input_.object.appearance->color({points.positions.detach(), points.rast.detach()});
        }
        shown.rgb = color_distance(options_.naturalness.color_space, shown.colors, clean) / pixels;
        std::vector<Tensor> channels = {shown.colors};
        if (with_clean) {
          channels.push_back(clean);
          channels.push_back(at::ones({1, clean.size(1)}, clean.options()));  // alpha of the clean
                                                                              // colours
        }
        if (with_normals) {
          channels.push_back(object::at_points(scene::vertex_normals(vertices, prepared_.faces),
                                               points, prepared_.faces));
        }
        return channels.size() == 1 ? shown.colors : at::cat(channels);
      });
  // Slice while the layout is channels-last, so that the gradients are channels-last too.
  const auto channels = [&](int64_t first, int64_t count) {
    return rendered.narrow(3, first, count).permute({0, 3, 1, 2});
  };
  shown.pictures = channels(0, 4);
  if (with_clean) shown.clean = channels(4, 4);
  if (with_normals) shown.normals = channels(with_clean ? 8 : 4, 3);
  return shown;
}

}  // namespace tt3d::attack
