#pragma once

#include <ATen/core/Tensor.h>
#include <c10/core/Device.h>

#include <cstdint>
#include <filesystem>
#include <functional>
#include <vector>

#include "tt3d/capture.h"
#include "tt3d/core.h"

/// The two-grid radiance field of TT3D (paper, section 3.1): a geometry grid and an appearance
/// grid, each a multiresolution hash encoding (Mueller et al., "Instant Neural Graphics
/// Primitives", TOG 2022), read by small MLPs. Everything lives in [-1,1]^3.
namespace tt3d {

// ---- Operators ----------------------------------------------------------------------------

/// A multiresolution hash grid. Level l has resolution base * (finest/base)^(l/(levels-1)).
struct HashGridShape {
  int64_t levels = 16;
  int64_t base = 16;
  int64_t finest = 2048;
  int64_t log2_size = 19;  ///< entries of a level at most 2^log2_size
  int64_t features = 2;    ///< numbers an entry, 1 or 2
  /// Entries of all levels together.
  [[nodiscard]] int64_t entries() const;
};

/// Encodes points: x [P,3] in [-1,1]^3 (clamped), table [entries, features].
/// Returns [levels * features, P]: one row a feature, levels outermost, so that the MLP reads
/// rows. Trilinear. Differentiable with respect to table, and to x where it asks for a gradient:
/// the CPU then keeps 3 numbers a point, level and feature until the backward pass.
[[nodiscard]] at::Tensor hash_encode(const at::Tensor& x, const at::Tensor& table,
                                     const HashGridShape& shape);

/// The points and their encoding stacked, as the field's MLPs read them: [3 + levels * features,
/// P].
[[nodiscard]] at::Tensor encode_points(const at::Tensor& x, const at::Tensor& table,
                                       const HashGridShape& shape);

/// A bias-free MLP with ReLU between layers and none at the end, fused layer to layer in cache
/// blocks. x [I,P] (a row an input feature), weights[k] [O_k,I_k]. Returns [O,P].
/// Differentiable with respect to x and weights.
[[nodiscard]] at::Tensor mlp(const at::Tensor& x, const std::vector<at::Tensor>& weights);

/// The same in mixed precision: factors rounded to float16, sums in float32, layers fused on tensor
/// cores. Gradients are scaled on their way, so that small ones survive. float32 x and weights; at
/// most 4 layers of at most 64 numbers.
/// What `mlp` does on the GPU under GpuOptions::half_mlp; on the CPU the same roundings, slowly.
[[nodiscard]] at::Tensor half_mlp(const at::Tensor& x, const std::vector<at::Tensor>& weights);

/// Volume rendering (Max 1995): densities [S], colors [3,S], steps [S] (lengths), and
/// ray_begin [R+1] int64, the samples of ray r being [ray_begin[r], ray_begin[r+1]).
/// Returns [R,4]: premultiplied colour and alpha. Stops a ray at transmittance 1e-4.
/// Differentiable with respect to densities and colors.
[[nodiscard]] at::Tensor composite(const at::Tensor& densities, const at::Tensor& colors,
                                   const at::Tensor& steps, const at::Tensor& ray_begin);

/// Samples along rays, and where each ray's begin.
struct RaySamples {
  at::Tensor points;     ///< [S,3]
  at::Tensor steps;      ///< [S] lengths
  at::Tensor ray_begin;  ///< [R+1] int64
};

/// Marches rays through the occupied cells of [-1,1]^3 in steps of equal length.
/// origins, directions (unit) [R,3]; occupied [G,G,G] uint8 over (z,y,x);
/// jitter [R] in [0,1) shifts each ray's first step. Not differentiable.
[[nodiscard]] RaySamples march_rays(const at::Tensor& origins, const at::Tensor& directions,
                                    const at::Tensor& occupied, const at::Tensor& jitter,
                                    double step, double near_distance);

/// The samples that are seen: drops those of each ray behind transmittance `threshold`.
/// Returns the indices kept [K] int64 and the new ray_begin [R+1].
[[nodiscard]] std::pair<at::Tensor, at::Tensor> visible_samples(const at::Tensor& densities,
                                                                const at::Tensor& steps,
                                                                const at::Tensor& ray_begin,
                                                                double threshold);

/// One Adam step (Kingma & Ba 2015) on a tensor, its moments beside it. Entries whose gradient is
/// exactly zero keep value and moments: hash entries that no sample touched do not drift
/// (instant-ngp does the same).
struct Adam {
  double beta1 = 0.9, beta2 = 0.99, epsilon = 1e-15;
  void step(const at::Tensor& parameter, const at::Tensor& gradient, const at::Tensor& moment1,
            const at::Tensor& moment2, double rate, int64_t iteration) const;
};

// ---- The field ----------------------------------------------------------------------------

/// Shape of the field; the defaults are the official code's.
struct FieldShape {
  HashGridShape geometry{16, 16, 2048, 19, 1};
  HashGridShape appearance{16, 16, 2048, 19, 2};
  int64_t density_hidden = 32;
  int64_t color_hidden = 64;
  int64_t specular_hidden = 32;
  int64_t occupancy = 128;  ///< cells a side
};

/// Hash grid and MLP that map a surface point to its colour: the field's appearance, and what the
/// dual attack optimises.
struct GridMlp {
  HashGridShape shape;
  at::Tensor grid;                    ///< [entries,2]
  std::vector<at::Tensor> color_mlp;  ///< 3+16*2 -> 64 -> 64 -> 6

  /// Diffuse colour in [0,1] and specular features: x [P,3]; returns [6,P] after the sigmoid,
  /// rows 0..2 the diffuse sRGB colour. Differentiable.
  [[nodiscard]] at::Tensor features(const at::Tensor& x) const;
  /// Diffuse colour alone, [3,P].
  [[nodiscard]] at::Tensor color(const at::Tensor& x) const;
  /// All parameters, grid first.
  [[nodiscard]] std::vector<at::Tensor> parameters() const;
  /// A deep copy.
  [[nodiscard]] GridMlp clone() const;
  /// The same on a device, without gradient; shares memory where it is there already.
  [[nodiscard]] GridMlp to(at::Device device) const;
};

/// The radiance field: density from the geometry grid, colour from the appearance.
struct RadianceField {
  FieldShape shape;
  at::Tensor geometry_grid;             ///< [entries,1]
  std::vector<at::Tensor> density_mlp;  ///< 3+16 -> 32 -> 1
  GridMlp appearance;
  std::vector<at::Tensor> specular_mlp;  ///< 3+3 -> 32 -> 3
  at::Tensor occupied;                   ///< [G,G,G] uint8 over (z,y,x)

  /// Fresh parameters: grids U(-1e-4,1e-4), layers He-uniform; everything occupied.
  static RadianceField create(const FieldShape& shape, uint64_t seed);
  /// Density >= 0 per unit length, x [P,3] -> [P]. Differentiable.
  [[nodiscard]] at::Tensor density(const at::Tensor& x) const;
  /// Colour seen from `directions` [P,3] (unit, camera to point): clamp(diffuse + specular),
  /// [3,P]. With `specular_out` also returns the specular part. Differentiable.
  [[nodiscard]] at::Tensor color(const at::Tensor& x, const at::Tensor& directions,
                                 bool with_specular, at::Tensor* specular_out = nullptr) const;
  /// All parameters in a fixed order.
  [[nodiscard]] std::vector<at::Tensor> parameters() const;
  /// The same on a device, without gradient; shares memory where it is there already.
  [[nodiscard]] RadianceField to(at::Device device) const;
  [[nodiscard]] at::Device device() const { return geometry_grid.device(); }

  void save(const std::filesystem::path& path) const;
  /// Throws InputError for a file that is not such a field.
  static RadianceField load(const std::filesystem::path& path);
};

/// Training options; defaults are the official code's unless said otherwise.
struct FieldOptions {
  FieldShape shape;
  int64_t steps = 15000;
  int64_t samples_per_step = int64_t{1} << 18;
  int64_t ray_steps = 1024;         ///< steps across the box's diagonal
  double rate = 1e-2;               ///< Adam's learning rate at its peak
  int64_t warmup = 500;             ///< steps of linear warm-up, at most a tenth of all
  double diffuse_share = 1.0 / 15;  ///< share of the steps with diffuse colour only
  double mask_weight = 0.1;
  double specular_weight = 1e-5;
  double tv_weight = 1e-8;
  int64_t checkpoint_every = 250;
  at::Device device = at::kCPU;  ///< where it trains; the result lies there
};

/// Renders a camera's view: [H,W,4] premultiplied colour and alpha, no gradient.
[[nodiscard]] at::Tensor render_field(const RadianceField& field, const Camera& camera,
                                      double step);

/// Mean PSNR over views, each composited over white, as NeRF papers report it.
using ViewRenderer = std::function<at::Tensor(const Camera&)>;  ///< -> [H,W,4] premultiplied
[[nodiscard]] double mean_psnr(const std::vector<View>& views, const ViewRenderer& render,
                               Progress& progress);

/// The target of a view's pixels: premultiplied colour and alpha [H,W,4] float32 in [0,1]. The one
/// place where straight alpha becomes premultiplied: every loss and metric composites from here.
[[nodiscard]] at::Tensor premultiplied(const View& view);
/// Premultiplied [...,4] over a background colour [...,3] or scalar: rgb + (1 - alpha) *
/// background.
[[nodiscard]] at::Tensor over_background(const at::Tensor& rgba, const at::Tensor& background);

/// Trains a field. `checkpoint` is the file that holds the state on the way; when it exists the
/// training goes on from it and gives the same bytes as without the stop.
/// Throws InputError for a capture without masks, NumericError when it diverges for good.
[[nodiscard]] RadianceField fit_field(const Capture& capture, const FieldOptions& options,
                                      uint64_t seed, const std::filesystem::path& checkpoint,
                                      Progress& progress);

/// A renderer of the field for mean_psnr, with the options' step.
[[nodiscard]] double ray_step(const FieldOptions& options);

}  // namespace tt3d
