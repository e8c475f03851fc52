#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <filesystem>
#include <vector>

#include "tt3d/keys.h"
#include "tt3d/scene.h"

/// Expectation over transformation (Athalye et al., "Synthesizing robust adversarial examples",
/// ICML 2018): random changes of an object and its pictures, between the attack and a classifier.
namespace tt3d::attack {

/// Ranges of the transforms, in the order of their application. Each picture has its own draw,
/// except for blur, resolution and noise: one draw per batch.
struct EotOptions {
  // In 3D.
  double object_shift = 0, light = 0;
  // Place in the frame, before compositing.
  double scale_low = 0.7, scale_high = 1.15, shift = 0.1, rotation_deg = 10;
  // Background; the other pictures are on white.
  double plain_background = 0.5, photograph_background = 0;
  std::filesystem::path photographs;
  // Light and colour.
  double brightness = 0.2, contrast = 0.2, saturation = 0.2;
  // Camera and file.
  double blur = 1.0, resolution = 1, noise = 0.02, jpeg = 0;
  int jpeg_quality_low = 40, jpeg_quality_high = 95;
  // Against overfitting to the surrogates; these are no effects of a camera.
  double mix = 0, diversity = 0, diversity_low = 0.8;

  void keys(KeyList& key) {
    key("object_shift", object_shift, {0, 1}, "object radii",
        "largest shift of the object along each axis, in both directions; 0: off, as for all keys "
        "below");
    key("light", light, {0, 0.75}, "",
        "largest share of the light that comes from one random direction");
    key("scale_low", scale_low, {0.05, 4}, "", "smallest size of the picture in the frame");
    key("scale_high", scale_high, {0.05, 4}, "", "largest size of the picture in the frame");
    key("shift", shift, {0, 1}, "frame sides", "largest shift in the frame, in both directions");
    key("rotation_deg", rotation_deg, {0, 180}, "degrees",
        "largest in-plane rotation, in both directions");
    key("plain_background", plain_background, {0, 1}, "",
        "share of pictures on a random plain colour");
    key("photograph_background", photograph_background, {0, 1}, "",
        "share of pictures on a photograph; the rest are on white");
    key("photographs", photographs, "folder of the photographs for backgrounds and mix");
    key("brightness", brightness, {0, 1}, "", "factor from 1 - b to 1 + b");
    key("contrast", contrast, {0, 1}, "", "factor from 1 - c to 1 + c, around the mean");
    key("saturation", saturation, {0, 1}, "",
        "factor from 1 - s to 1 + s, around the grey picture");
    key("blur", blur, {0, 10}, "pixels", "largest sigma of Gaussian blur");
    key("resolution", resolution, {0.05, 1}, "",
        "each side is reduced to this share or more of its pixels, and enlarged again; 1: off");
    key("noise", noise, {0, 1}, "", "largest sigma of Gaussian noise");
    key("jpeg", jpeg, {0, 1}, "", "share of pictures that are compressed as JPEG");
    key("jpeg_quality_low", jpeg_quality_low, {1, 100}, "", "lowest JPEG quality (as in libjpeg)");
    key("jpeg_quality_high", jpeg_quality_high, {1, 100}, "", "highest JPEG quality");
    key("mix", mix, {0, 1}, "",
        "factor of a photograph that is added to each picture (Admix; Wang et al., ICCV 2021)");
    key("diversity", diversity, {0, 1}, "",
        "share of pictures that are shrunk and padded with black (Xie et al., CVPR 2019)");
    key("diversity_low", diversity_low, {0.1, 1}, "", "smallest size of the shrunk pictures");
  }
};

/// Transforms premultiplied renderings [N,4,H,W] and composites them over backgrounds:
/// [N,3,size,size] in [0,1]. Placement comes before compositing and colour changes after it, so the
/// padding is background, not black. `photographs`: used by photograph_background and mix. The
/// draws depend on (seed, step) alone. Differentiable.
[[nodiscard]] at::Tensor transform_images(const at::Tensor& images, int64_t size,
                                          const EotOptions& options, uint64_t seed, int64_t step,
                                          const scene::Backgrounds* photographs = nullptr);

/// Moves each camera so that it sees the object, of radius `radius`, shifted by object_shift. One
/// draw per camera.
[[nodiscard]] std::vector<scene::Camera> shift_object(std::vector<scene::Camera> cameras,
                                                      double radius, const EotOptions& options,
                                                      uint64_t seed, int64_t step);

/// Changes the light on a matte surface in pictures [N,4,H,W], one draw per picture. A share of the
/// light comes from one direction, uniform over the sphere; the rest is even. The mean over all
/// surface directions stays unchanged. `normals` [N,3,H,W]: surface normals of the pixels, of any
/// length but 0. Differentiable.
[[nodiscard]] at::Tensor light_pictures(const at::Tensor& images, const at::Tensor& normals,
                                        const EotOptions& options, uint64_t seed, int64_t step);

/// Differentiable approximation of JPEG. Colour space, halved chroma and the quantised 8x8 cosine
/// transform follow the standard and libjpeg. The rounding is the smooth one of Shin and Song,
/// "JPEG-resistant adversarial images", NIPS workshop 2017: [x] + (x - [x])^3. images [N,3,H,W] in
/// [0,1], `qualities` 1..100, one per picture. Returns the same shape in [0,1].
[[nodiscard]] at::Tensor jpeg_stand_in(const at::Tensor& images, const std::vector<int>& qualities);

}  // namespace tt3d::attack
