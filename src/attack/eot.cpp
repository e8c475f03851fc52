#include <ATen/ATen.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>

#include "picture_ops.h"
#include "tt3d/eot.h"
#include "tt3d/image.h"
#include "tt3d/lighting.h"
#include "tt3d/random_tensor.h"
#include "tt3d/scene.h"

namespace tt3d::attack {
namespace {

using at::Tensor;

constexpr int64_t kBilinear = 0, kZeros = 0;  // enum values of at::grid_sampler
constexpr double kLeastBlur = 0.2;            // pixels; a smaller sigma means no blur

/// One number per picture, shaped to broadcast over `pictures` [N,C,H,W], on their device.
Tensor column(const std::vector<float>& values, const Tensor& pictures) {
  return at::tensor(values).view({-1, 1, 1, 1}).to(pictures.device());
}

/// Affine maps from the frame to the picture: rotation, scale and translation. [N,2,3].
Tensor placements(int64_t count, const EotOptions& o, Random& random) {
  Tensor theta = at::empty({count, 2, 3});
  auto* p = theta.mutable_data_ptr<float>();
  for (int64_t i = 0; i < count; ++i, p += 6) {
    const double angle = random.uniform(-1, 1) * o.rotation_deg * std::numbers::pi / 180;
    const double inverse = 1 / random.uniform(o.scale_low, o.scale_high);
    const double dx = random.uniform(-1, 1) * 2 * o.shift, dy = random.uniform(-1, 1) * 2 * o.shift;
    const double c = std::cos(angle) * inverse, s = std::sin(angle) * inverse;
    const double m[6] = {c, -s, -(c * dx - s * dy), s, c, -(s * dx + c * dy)};
    for (int k = 0; k < 6; ++k) p[k] = static_cast<float>(m[k]);
  }
  return theta;
}

/// A plain colour, a photograph or white for each picture. Returns [N,3,1,1], or [N,3,size,size] if
/// photographs are given.
Tensor backgrounds(int64_t count, int64_t size, const EotOptions& o,
                   const scene::Backgrounds* photographs, Random& random) {
  const int64_t side = photographs == nullptr ? 1 : size;
  Tensor out = at::ones({count, 3, side, side});
  for (int64_t i = 0; i < count; ++i) {
    const double kind = random.uniform();
    const Tensor plain = at::tensor({random.uniform(), random.uniform(), random.uniform()});
    if (kind < o.plain_background) {
      out[i].copy_(plain.view({3, 1, 1}));
    } else if (photographs != nullptr && kind < o.plain_background + o.photograph_background) {
      out[i].copy_(photographs->draw(size, size, random).permute({2, 0, 1}));
    }
  }
  return out;
}

std::vector<float> factors(int64_t count, double spread, Random& random) {
  std::vector<float> out;
  for (int64_t i = 0; i < count; ++i) {
    out.push_back(static_cast<float>(random.uniform(1 - spread, 1 + spread)));
  }
  return out;
}

/// Brightness b, contrast c around the mean, saturation s around the grey picture: together
///   y = A x + d,  A = b c (s I + (1 - s) 1 luma^T),  d = (1 - c) b mean(x),
/// One matrix product per picture replaces three passes over the pixels.
Tensor jitter_colors(const Tensor& x, const EotOptions& o, Random& random) {
  const int64_t n = x.size(0);
  const Tensor brightness = column(factors(n, o.brightness, random), x).view({n, 1, 1});
  const Tensor contrast = column(factors(n, o.contrast, random), x).view({n, 1, 1});
  const Tensor saturation = column(factors(n, o.saturation, random), x).view({n, 1, 1});
  const Tensor luma = at::tensor({0.299F, 0.587F, 0.114F}).repeat({3, 1}).to(x.device());
  const Tensor mixed =
      brightness * contrast * (saturation * at::eye(3, x.options()) + (1 - saturation) * luma);
  const Tensor pixels = x.reshape({n, 3, -1});
  const Tensor shift = (1 - contrast) * brightness * pixels.mean({1, 2}, true);
  return at::baddbmm(shift, mixed, pixels).view(x.sizes());
}

/// Reduces each side to a share of its pixels and enlarges it again, as a small sensor or a resize
/// does.
Tensor reduce_resolution(const Tensor& x, double share) {
  const int64_t height = x.size(2), width = x.size(3);
  const auto pixels = [&](int64_t side) {
    return std::max<int64_t>(1, std::llround(share * static_cast<double>(side)));
  };
  const Tensor small = at::_upsample_bilinear2d_aa(x, {pixels(height), pixels(width)}, false);
  return at::upsample_bilinear2d(small, {height, width}, false);
}

/// Compresses a share of the pictures as JPEG, each with its own random quality.
Tensor compress(const Tensor& x, const EotOptions& o, Random random) {
  std::vector<int64_t> chosen;
  std::vector<int> qualities;
  for (int64_t i = 0; i < x.size(0); ++i) {
    const bool coded = random.uniform() < o.jpeg;
    const auto spread = random.index(o.jpeg_quality_high - o.jpeg_quality_low + 1);
    if (!coded) continue;
    chosen.push_back(i);
    qualities.push_back(o.jpeg_quality_low + static_cast<int>(spread));
  }
  if (chosen.empty()) return x;
  const Tensor index = at::tensor(chosen, at::kLong).to(x.device());
  return x.index_copy(0, index, jpeg_stand_in(x.index_select(0, index), qualities));
}

/// Adds a share of a random photograph to each picture. The picture itself is not scaled.
Tensor mix_in(const Tensor& x, double share, const scene::Backgrounds& photographs, Random random) {
  std::vector<Tensor> others;
  for (int64_t i = 0; i < x.size(0); ++i) {
    others.push_back(photographs.draw(x.size(2), x.size(3), random).permute({2, 0, 1}));
  }
  return (x + at::stack(others).to(x.device()) * share).clamp(0, 1);
}

/// Shrinks a share of the pictures and pads them with black. The position is random.
Tensor diversify(const Tensor& x, const EotOptions& o, Random random) {
  std::vector<int64_t> chosen;
  std::vector<float> maps;
  for (int64_t i = 0; i < x.size(0); ++i) {
    const bool taken = random.uniform() < o.diversity;
    const double size = random.uniform(o.diversity_low, 1);
    const double dx = random.uniform(-1, 1) * (1 - size), dy = random.uniform(-1, 1) * (1 - size);
    if (!taken) continue;
    chosen.push_back(i);
    for (const double m : {1 / size, 0.0, -dx / size, 0.0, 1 / size, -dy / size}) {
      maps.push_back(static_cast<float>(m));
    }
  }
  if (chosen.empty()) return x;
  const Tensor index = at::tensor(chosen, at::kLong).to(x.device());
  const Tensor theta = at::tensor(maps).view({-1, 2, 3}).to(x.device());
  const Tensor whole = x.index_select(0, index);
  const Tensor grid = at::affine_grid_generator(theta, whole.sizes(), false);
  return x.index_copy(0, index, at::grid_sampler(whole, grid, kBilinear, kZeros, false));
}

/// A random stream for one transform. Turning the transform on does not change the draws of the
/// others.
Random stream_of(const char* transform, uint64_t seed, int64_t step) {
  return Random(seed, std::string("attack/eot/") + transform, static_cast<uint64_t>(step));
}

}  // namespace

std::vector<scene::Camera> shift_object(std::vector<scene::Camera> cameras, double radius,
                                        const EotOptions& o, uint64_t seed, int64_t step) {
  if (o.object_shift <= 0) return cameras;
  Random random = stream_of("object_shift", seed, step);
  // An object shifted one way is a camera shifted the other way.
  for (scene::Camera& camera : cameras) {
    for (int k = 0; k < 3; ++k) {
      camera.camera_to_world[4 * k + 3] -= random.uniform(-1, 1) * o.object_shift * radius;
    }
  }
  return cameras;
}

Tensor light_pictures(const Tensor& images, const Tensor& normals, const EotOptions& o,
                      uint64_t seed, int64_t step) {
  if (o.light <= 0) return images;
  Random random = stream_of("light", seed, step);
  std::vector<float> directions, shares;
  for (int64_t i = 0; i < images.size(0); ++i) {
    const double z = random.uniform(-1, 1), turn = random.uniform(0, 2 * std::numbers::pi);
    const double flat = std::sqrt(1 - z * z);
    for (const double x : {flat * std::cos(turn), flat * std::sin(turn), z}) {
      directions.push_back(static_cast<float>(x));
    }
    shares.push_back(static_cast<float>(random.uniform(0, o.light)));
  }
  const Tensor towards = at::tensor(directions).view({-1, 3, 1, 1}).to(images.device());
  const Tensor length = (normals.square().sum(1, true) + 1e-12).sqrt();
  const Tensor cosine = (normals * towards).sum(1, true) / length;
  const Tensor share = column(shares, images);
  // The mean of lobe() over the sphere is 1/4.
  const Tensor factor = (1 - share + share * 4 * object::lobe(cosine)).clamp_min(0);
  return at::cat({images.narrow(1, 0, 3) * factor, images.narrow(1, 3, 1)}, 1);
}

Tensor transform_images(const Tensor& images, int64_t size, const EotOptions& o, uint64_t seed,
                        int64_t step, const scene::Backgrounds* photographs) {
  Random random(seed, "attack/eot", static_cast<uint64_t>(step));
  const int64_t n = images.size(0);
  const Tensor maps = placements(n, o, random).to(images.device());
  const Tensor behind = backgrounds(n, size, o, photographs, random).to(images.device());
  Tensor x = jitter_colors(place_over(images, maps, behind, size), o, random);
  const double blur_sigma = random.uniform(0, 1) * o.blur;
  if (blur_sigma >= kLeastBlur) x = image::gaussian_blur(x, blur_sigma);
  if (o.resolution < 1) {
    Random own = stream_of("resolution", seed, step);
    x = reduce_resolution(x, own.uniform(o.resolution, 1));
  }
  if (o.noise > 0) {
    const double sigma = random.uniform(0, 1) * o.noise;
    x = at::add(x, noise_tensor(x.sizes(), stream_of("noise", seed, step).key(), x.device()),
                sigma);
  }
  x = at::hardtanh(x, 0, 1);  // clamp, with a gradient in one pass
  if (o.jpeg > 0) x = compress(x, o, stream_of("jpeg", seed, step));
  if (o.mix > 0 && photographs != nullptr)
    x = mix_in(x, o.mix, *photographs, stream_of("mix", seed, step));
  if (o.diversity > 0) x = diversify(x, o, stream_of("diversity", seed, step));
  return x;
}

}  // namespace tt3d::attack
