#include "naturalness.h"

#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>

#include <cmath>
#include <sstream>

#include "picture_ops.h"
#include "tt3d/image.h"
#include "tt3d/input_files.h"
#include "tt3d/mesh.h"

namespace tt3d::attack {
namespace {

using at::Tensor;

/// The mean squared error of a PSNR, for pictures in [0,1].
double mse_of_psnr(double psnr) { return psnr > 0 ? std::pow(10.0, -psnr / 10) : 0.0; }

/// Reads the colour of a line; false for a line without one.
bool parse_color(std::string line, float* color) {
  line = line.substr(0, line.find('#'));
  for (char& c : line) {
    if (c == ',') c = ' ';
  }
  if (line.find_first_not_of(" \t\r") == std::string::npos) return false;
  std::istringstream in(line);
  std::string rest;
  const bool three = static_cast<bool>(in >> color[0] >> color[1] >> color[2]);
  if (!three || in >> rest) throw InputError("expected three numbers");
  for (int k = 0; k < 3; ++k) {
    if (!(color[k] >= 0 && color[k] <= 1)) throw InputError("expected numbers from 0 to 1");
  }
  return true;
}

}  // namespace

Tensor total_variation(const Tensor& images) {
  constexpr double kSmooth = 1e-4;
  const int64_t height = images.size(2), width = images.size(3);
  const Tensor here = images.narrow(2, 0, height - 1).narrow(3, 0, width - 1);
  const Tensor below = images.narrow(2, 1, height - 1).narrow(3, 0, width - 1) - here;
  const Tensor right = images.narrow(2, 0, height - 1).narrow(3, 1, width - 1) - here;
  return ((below.square() + right.square() + kSmooth * kSmooth).sqrt() - kSmooth).mean();
}

Tensor non_printability(const Tensor& colors, const Tensor& printable) {
  // Choose the nearest without a gradient. Then only the distance to it has a gradient, which is
  // finite at 0 too.
  Tensor nearest;
  {
    at::NoGradGuard guard;
    nearest = printable.index_select(0, at::cdist(colors.t().contiguous(), printable).argmin(1));
  }
  constexpr double kSmooth = 1e-6;
  return ((colors.t() - nearest).square().sum(1) + kSmooth * kSmooth).sqrt().mean();
}

Tensor process_ink_mixes() {
  // Typical sRGB values of the inks. Those of a real printer differ, so its own list is better.
  constexpr double kInks[3][3] = {{0, 0.68, 0.94}, {0.93, 0, 0.55}, {1, 0.95, 0}};
  std::vector<float> mixes;
  for (int mix = 0; mix < 27; ++mix) {
    const int halves[3] = {mix % 3, mix / 3 % 3, mix / 9};
    const double coverage[3] = {halves[0] / 2.0, halves[1] / 2.0, halves[2] / 2.0};
    for (int k = 0; k < 3; ++k) {
      double value = 1;
      for (int ink = 0; ink < 3; ++ink) value *= 1 - coverage[ink] * (1 - kInks[ink][k]);
      mixes.push_back(static_cast<float>(value));
    }
  }
  return at::tensor(mixes).view({-1, 3});
}

Tensor load_printer_colors(const std::filesystem::path& path) {
  std::istringstream in(read_text(path));
  std::vector<float> values;
  std::string line;
  for (long number = 1; std::getline(in, line); ++number) {
    float color[3] = {};
    try {
      if (parse_color(line, color)) values.insert(values.end(), color, color + 3);
    } catch (const InputError& error) {
      throw InputError(path, number, error.what());
    }
  }
  if (values.empty()) throw InputError(path, "holds no colours, expected three numbers a line");
  return at::tensor(values).view({-1, 3});
}

void limit_offsets(const Tensor& offsets, double most) {
  at::NoGradGuard guard;
  const Tensor length = offsets.norm(2, {1}, /*keepdim=*/true);
  offsets.mul_((most / length.clamp_min(1e-30)).clamp_max(1));
}

Naturalness::Naturalness(const AttackInput& input, const AttackOptions& options)
    : options_(options),
      shape_is_free_(options.optimizes(object::Part::kVertices)),
      regularizer_(input.object.mesh, options.naturalness.laplacian),
      rest_(input.object.mesh.vertices) {
  at::NoGradGuard guard;
  rest_edge_ = regularizer_.edge_length(rest_).item<double>();
  if (options.naturalness.printability_weight > 0) {
    printable_ = (options.naturalness.printer_colors.empty()
                      ? process_ink_mixes()
                      : load_printer_colors(options.naturalness.printer_colors))
                     .to(rest_.device());
  }
}

bool Naturalness::compares_pictures() const {
  return options_.naturalness.ssim_floor > 0 || options_.naturalness.variation_weight > 0;
}

Naturalness::Terms Naturalness::terms(const Rendering& shown, const Tensor& vertices) const {
  const Tensor zero = at::zeros({}, vertices.options());
  Terms t = {{}, zero, zero, zero};
  if (shape_is_free_) {
    t.chamfer = regularizer_.chamfer(vertices);
    t.laplacian = regularizer_.laplacian(vertices);
    t.edge = regularizer_.edge_length(vertices) - rest_edge_;
  }
  const Tensor excess = (shown.rgb - mse_of_psnr(options_.naturalness.psnr_floor)).clamp_min(0);
  t.total = options_.naturalness.rgb_weight * excess +
            options_.naturalness.chamfer_weight * t.chamfer +
            options_.naturalness.laplacian_weight * t.laplacian +
            options_.naturalness.edge_weight * t.edge +
            options_.naturalness.ssim_weight * missing_similarity(shown);
  if (shape_is_free_ && options_.naturalness.displacement_weight > 0) {
    t.total = t.total +
              options_.naturalness.displacement_weight * regularizer_.edge_length(vertices - rest_);
  }
  if (options_.naturalness.variation_weight > 0) {
    const Tensor change = shown.pictures.narrow(1, 0, 3) - shown.clean.narrow(1, 0, 3);
    t.total = t.total + options_.naturalness.variation_weight * total_variation(change);
  }
  if (printable_.defined()) {
    t.total = t.total +
              options_.naturalness.printability_weight * non_printability(shown.colors, printable_);
  }
  return t;
}

/// How far the mean SSIM of the pictures is below the floor. Every second window is enough for a
/// mean.
Tensor Naturalness::missing_similarity(const Rendering& shown) const {
  if (options_.naturalness.ssim_floor <= 0) return at::zeros({}, shown.pictures.options());
  constexpr int64_t kStride = 2;
  const Tensor similarity = image::structural_similarity(over_white(shown.pictures),
                                                         over_white(shown.clean.detach()), kStride);
  return (options_.naturalness.ssim_floor - similarity.mean()).clamp_min(0);
}

}  // namespace tt3d::attack
