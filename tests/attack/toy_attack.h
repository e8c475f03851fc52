#pragma once

#include <memory>
#include <string>
#include <vector>

#include "support/shapes.h"
#include "tt3d/appearance.h"
#include "tt3d/attack.h"
#include "tt3d/surface.h"

/// A small attack for the tests on CPU and GPU.
namespace tt3d::testing {

inline double value(const at::Tensor& x) { return x.item<double>(); }

/// A classifier of three classes. Its logits are `gain` times the means of red, green and blue of a
/// picture.
class ColorClassifier : public model::Classifier {
 public:
  explicit ColorClassifier(double gain = 40,
                           const std::vector<std::string>& labels = {"red", "green", "blue"})
      : gain_(gain) {
    card_.name = "colors";
    card_.height = card_.width = card_.resize = 32;
    card_.labels = labels;
  }
  [[nodiscard]] const model::ModelCard& card() const override { return card_; }
  [[nodiscard]] at::Tensor logits(const at::Tensor& images) const override {
    return images.mean({2, 3}) * gain_;
  }
  [[nodiscard]] std::string weights_hash() const override { return "none"; }
  [[nodiscard]] const model::ProbeReport& probe() const override { return probe_; }
  [[nodiscard]] const std::filesystem::path& path() const override { return path_; }

 private:
  double gain_;
  model::ModelCard card_;
  model::ProbeReport probe_;
  std::filesystem::path path_;
};

/// No transforms; pictures are on white.
inline attack::EotOptions no_transforms() {
  attack::EotOptions o;
  o.scale_low = o.scale_high = 1;
  o.shift = o.rotation_deg = o.brightness = o.contrast = o.saturation = o.blur = o.noise = 0;
  o.plain_background = 0;
  return o;
}

/// The options of a preset at the size of a test: 40 steps, no naturalness.
inline attack::AttackOptions toy_options(
    const attack::AttackPreset& preset = attack::attack_preset("dual")) {
  attack::AttackOptions o;
  o.objective.loss = attack::Objective::kCrossEntropy;
  o.naturalness.psnr_floor = o.naturalness.ssim_floor = 0;
  preset.change(o);
  o.schedule.steps = 40;
  o.schedule.views_per_step = 2;
  o.schedule.image_size = 32;
  o.naturalness.beta = 0;
  o.eot = {};
  o.eot.plain_background = 0;
  o.schedule.checkpoint_every = 6;
  return o;
}

/// True if the options free the colours on the whole surface.
inline bool frees_colors(const attack::AttackOptions& o) {
  return o.optimize != std::vector{object::Part::kVertices} && o.sticker.area == 0;
}

/// The input of an attack on a ball: makes ColorClassifier choose `target`. On `device`.
inline attack::AttackInput ball_input(int64_t target, at::Device device = at::kCPU) {
  const Shape s = sphere(3, 0.7F);
  field::FieldShape shape;
  shape.geometry = {2, 4, 8, 8, 1};
  shape.appearance = {6, 8, 64, 12, 2};
  shape.occupancy = 8;
  attack::AttackInput input;
  input.object.mesh = scene::TriMesh{s.vertices, s.faces}.to(device);
  input.object.appearance = std::make_shared<object::GridMlpAppearance>(
      field::RadianceField::create(shape, 1).appearance.to(device));
  // The uvs are longitude and height; the seam does not matter for a mean colour.
  const at::Tensor around = at::atan2(s.vertices.select(1, 1), s.vertices.select(1, 0)) / 6.2832;
  const at::Tensor height = s.vertices.select(1, 2) / 1.4;
  input.object.map = scene::UvMap{at::stack({around, height}, 1) + 0.5, s.faces}.to(device);
  input.texels = at::full({32, 32, 3}, 128, at::kByte).to(device);
  input.frame = {{0, 0, 0}, 1, 3.2, 40};
  input.surrogates = {std::make_shared<ColorClassifier>()};
  input.classes = {target};
  return input;
}

}  // namespace tt3d::testing
