#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <filesystem>
#include <vector>

#include "tt3d/capture.h"

/// Expectation over transformation (Athalye et al., "Synthesizing robust adversarial examples",
/// ICML 2018): what happens to an object and its pictures between the attack and a classifier.
namespace tt3d {

/// Range of each transform, drawn anew for every picture unless said otherwise; in the order in
/// which they are applied. The value in parentheses switches a transform off.
struct EotOptions {
  // In 3D.
  double object_shift = 0;  ///< shift of the object along each axis, of its radius, each way (0)
  double light = 0;  ///< share of the light that comes from one random direction, U(0, light) (0)
  // Place in the frame, before compositing.
  double scale_low = 0.7, scale_high = 1.15;  ///< size of the picture in the frame (both 1)
  double shift = 0.1;                         ///< of the frame's side, each way (0)
  double rotation_deg = 10;                   ///< each way (0)
  // Background; the rest of the pictures is on white.
  double plain_background = 0.5;      ///< share of pictures on a random plain colour (0)
  double photograph_background = 0;   ///< share on a photograph (0)
  std::filesystem::path photographs;  ///< folder of these photographs
  // Light and colour.
  double brightness = 0.2;  ///< factor U(1-b, 1+b) (0)
  double contrast = 0.2;    ///< likewise, around the picture's mean (0)
  double saturation = 0.2;  ///< likewise, around the grey picture (0)
  // Camera and file.
  double blur = 1.0;      ///< Gaussian, sigma U(0,blur) pixels, one draw for the batch (0)
  double resolution = 1;  ///< down to U(resolution,1) of the pixels a side and up again, one draw
                          ///< for the batch (1)
  double noise = 0.02;    ///< Gaussian, sigma U(0,noise), one draw for the batch (0)
  double jpeg = 0;        ///< share of pictures that pass through JPEG (0)
  int jpeg_quality_low = 40, jpeg_quality_high = 95;  ///< libjpeg's quality, 1 to 100
  // Against overfitting to the surrogates; no camera does this.
  double mix = 0;  ///< share of a photograph that is added (Admix; Wang et al., ICCV 2021) (0)
  double diversity = 0;  ///< share of pictures that are shrunk and padded with black at a random
                         ///< place (Xie et al., CVPR 2019) (0)
  double diversity_low = 0.8;  ///< smallest size of these
};

/// `images` [N,4,H,W] premultiplied rendering, transformed and composited over a background:
/// [N,3,size,size] in [0,1]. Placement happens before compositing and colours after, so the
/// padding is background, not black. `photographs`: what photograph_background and mix show.
/// Keyed by (seed, step). Differentiable.
[[nodiscard]] at::Tensor transform_images(const at::Tensor& images, int64_t size,
                                          const EotOptions& options, uint64_t seed, int64_t step,
                                          const Backgrounds* photographs = nullptr);

/// Cameras that see an object of radius `radius` shifted by object_shift, another draw for each.
[[nodiscard]] std::vector<Camera> shift_object(std::vector<Camera> cameras, double radius,
                                               const EotOptions& options, uint64_t seed,
                                               int64_t step);

/// Lights pictures [N,4,H,W] of a matte surface by another draw for each: a share of light from one
/// direction, uniform over the sphere, the rest even, and as much of it over all directions as
/// before. `normals` [N,3,H,W] of what they show, of any length but 0. Differentiable.
[[nodiscard]] at::Tensor light_pictures(const at::Tensor& images, const at::Tensor& normals,
                                        const EotOptions& options, uint64_t seed, int64_t step);

/// What JPEG makes of pictures, with a gradient: colour space, halved chroma and the quantised 8x8
/// cosine transform as the standard and libjpeg have them, but with the smooth rounding of Shin and
/// Song, "JPEG-resistant adversarial images", NIPS workshop 2017: [x] + (x - [x])^3.
/// images [N,3,H,W] in [0,1], `qualities` 1..100, one a picture. Returns the same shape in [0,1].
[[nodiscard]] at::Tensor jpeg_stand_in(const at::Tensor& images, const std::vector<int>& qualities);

}  // namespace tt3d
