#pragma once

#include <memory>
#include <string>
#include <vector>

#include "support/shapes.h"
#include "tt3d/attack.h"

/// A small attack that the CPU's and the GPU's tests share.
namespace tt3d::testing {

/// A classifier of three classes that answers with `gain` times the mean of a picture's red, green
/// and blue.
class ColorClassifier : public Classifier {
 public:
  explicit ColorClassifier(double gain = 40,
                           const std::vector<std::string>& labels = {"red", "green", "blue"})
      : gain_(gain) {
    card_.name = "colors";
    card_.height = card_.width = card_.resize = 32;
    card_.labels = labels;
  }
  [[nodiscard]] const ModelCard& card() const override { return card_; }
  [[nodiscard]] at::Tensor logits(const at::Tensor& images) const override {
    return images.mean({2, 3}) * gain_;
  }
  [[nodiscard]] std::string weights_hash() const override { return "none"; }
  [[nodiscard]] const ProbeReport& probe() const override { return probe_; }
  [[nodiscard]] const std::filesystem::path& path() const override { return path_; }

 private:
  double gain_;
  ModelCard card_;
  ProbeReport probe_;
  std::filesystem::path path_;
};

/// Pictures as they are, on white.
inline EotOptions no_transforms() {
  EotOptions o;
  o.scale_low = o.scale_high = 1;
  o.shift = o.rotation_deg = o.brightness = o.contrast = o.saturation = o.blur = o.noise = 0;
  o.plain_background = 0;
  return o;
}

/// A preset's choices at a size for tests: 40 steps, no naturalness.
inline AttackOptions toy_options(const AttackPreset& preset = attack_preset("dual")) {
  AttackOptions o;
  preset.change(o);
  o.steps = 40;
  o.views_per_step = 2;
  o.image_size = 32;
  o.beta = 0;
  o.eot = {};
  o.eot.plain_background = 0;
  o.checkpoint_every = 6;
  return o;
}

/// True if the options free the colours, and everywhere.
inline bool frees_colors(const AttackOptions& o) {
  return o.optimize != std::vector<std::string>{"vertices"} && o.sticker_area == 0;
}

/// A ball whose colours ColorClassifier shall take for `target`, on `device`.
inline AttackInput ball_input(int64_t target, at::Device device = at::kCPU) {
  const Shape s = sphere(3, 0.7F);
  FieldShape shape;
  shape.geometry = {2, 4, 8, 8, 1};
  shape.appearance = {6, 8, 64, 12, 2};
  shape.occupancy = 8;
  AttackInput input;
  input.mesh = TriMesh{s.vertices, s.faces}.to(device);
  input.appearance =
      std::make_shared<GridMlpAppearance>(RadianceField::create(shape, 1).appearance.to(device));
  // Longitude and height as a map; its seam does not matter to a mean colour.
  const at::Tensor around = at::atan2(s.vertices.select(1, 1), s.vertices.select(1, 0)) / 6.2832;
  const at::Tensor height = s.vertices.select(1, 2) / 1.4;
  input.map = TextureMap{at::stack({around, height}, 1) + 0.5, s.faces}.to(device);
  input.texels = at::full({32, 32, 3}, 128, at::kByte).to(device);
  input.frame = {{0, 0, 0}, 1, 3.2, 40};
  input.surrogates = {std::make_shared<ColorClassifier>()};
  input.classes = {target};
  return input;
}

}  // namespace tt3d::testing
