#pragma once

#include <ATen/core/Tensor.h>
#include <c10/core/Device.h>

#include <cstdint>
#include <filesystem>
#include <functional>
#include <vector>

#include "tt3d/capture.h"
#include "tt3d/core.h"
#include "tt3d/keys.h"
#include "tt3d/scene.h"

/// The two-grid radiance field of TT3D (paper, section 3.1): a geometry grid and an appearance
/// grid, each a multiresolution hash encoding (Mueller et al., "Instant Neural Graphics
/// Primitives", TOG 2022), decoded by small MLPs. The domain is [-1,1]^3.
namespace tt3d::field {

// ---- Operators ----------------------------------------------------------------------------

/// A multiresolution hash grid. Level l has resolution base * (finest/base)^(l/(levels-1)).
struct HashGridShape {
  int64_t levels = 16;
  int64_t base = 16;
  int64_t finest = 2048;
  int64_t log2_size = 19;  ///< entries of a level at most 2^log2_size
  int64_t features = 2;    ///< numbers an entry, 1 or 2

  void keys(KeyList& key) {
    key("levels", levels, {1, 32}, "", "levels of the hash grid");
    key("base", base, {2, 512}, "cells", "resolution of its coarsest level");
    key("finest", finest, {2, 65536}, "cells", "resolution of its finest level");
    key("log2_size", log2_size, {8, 24}, "", "log2 of the entries of a level, at most");
  }
  /// Entries of all levels together.
  [[nodiscard]] int64_t entries() const;
};

/// Encodes points: x [P,3] in [-1,1]^3 (clamped), table [entries, features]. Returns [levels *
/// features, P]: one row per feature, levels outermost, so that the MLP reads rows. Trilinear.
/// Differentiable with respect to table, and to x if x requires a gradient; the CPU then keeps 3
/// numbers per point, level and feature until the backward pass.
[[nodiscard]] at::Tensor hash_encode(const at::Tensor& x, const at::Tensor& table,
                                     const HashGridShape& shape);

/// The points and their encoding stacked, the input of the field's MLPs: [3 + levels * features,
/// P].
[[nodiscard]] at::Tensor encode_points(const at::Tensor& x, const at::Tensor& table,
                                       const HashGridShape& shape);

/// A bias-free MLP with ReLU between layers and none at the end. The layers are fused: a block of
/// points stays in the cache from layer to layer. x [I,P] (one row per input feature), weights[k]
/// [O_k,I_k]. Returns [O,P]. Differentiable with respect to x and weights.
[[nodiscard]] at::Tensor mlp(const at::Tensor& x, const std::vector<at::Tensor>& weights);

/// The same in mixed precision: factors rounded to float16, sums in float32, layers fused on tensor
/// cores. Gradients are scaled before they are rounded, so that small ones survive. float32 x and
/// weights; at most 4 layers of at most 64 units. On the GPU `mlp` calls it under
/// GpuOptions::half_mlp. The CPU rounds in the same way, but slowly.
[[nodiscard]] at::Tensor half_mlp(const at::Tensor& x, const std::vector<at::Tensor>& weights);

/// Volume rendering (Max 1995): densities [S], colors [3,S], steps [S] (lengths), and ray_begin
/// [R+1] int64; the samples of ray r are [ray_begin[r], ray_begin[r+1]). Returns [R,4]:
/// premultiplied colour and alpha. Stops a ray at transmittance 1e-4. Differentiable with respect
/// to densities and colors.
[[nodiscard]] at::Tensor composite(const at::Tensor& densities, const at::Tensor& colors,
                                   const at::Tensor& steps, const at::Tensor& ray_begin);

/// Samples along rays, and the index of each ray's first sample.
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

/// Drops the samples of each ray that lie behind transmittance `threshold`. Returns the indices of
/// the samples kept, [K] int64, and the new ray_begin [R+1].
[[nodiscard]] std::pair<at::Tensor, at::Tensor> visible_samples(const at::Tensor& densities,
                                                                const at::Tensor& steps,
                                                                const at::Tensor& ray_begin,
                                                                double threshold);

// ---- The field ----------------------------------------------------------------------------

/// Shape of the field. The official code has finer and larger grids: 2048 cells, 2^19 entries.
struct FieldShape {
  HashGridShape geometry{16, 16, 1024, 17, 1};
  HashGridShape appearance{16, 16, 1024, 17, 2};
  int64_t density_hidden = 32;
  int64_t color_hidden = 64;
  int64_t specular_hidden = 32;
  int64_t occupancy = 128;  ///< occupancy cells per side
};

/// Hash grid and MLP that map a surface point to its colour: the field's appearance, which the dual
/// attack optimises.
struct GridMlp {
  HashGridShape shape;
  at::Tensor grid;                    ///< [entries,2]
  std::vector<at::Tensor> color_mlp;  ///< 3+16*2 -> 64 -> 64 -> 6

  /// Diffuse colour in [0,1] and specular features: x [P,3]; returns [6,P] after the sigmoid; rows
  /// 0..2 are the diffuse sRGB colour. Differentiable.
  [[nodiscard]] at::Tensor features(const at::Tensor& x) const;
  /// Diffuse colour alone, [3,P].
  [[nodiscard]] at::Tensor color(const at::Tensor& x) const;
  /// All parameters, grid first.
  [[nodiscard]] std::vector<at::Tensor> parameters() const;
  /// A deep copy.
  [[nodiscard]] GridMlp clone() const;
  /// The same on a device, without gradient; shares memory if it is there already.
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
  /// The same on a device, without gradient; shares memory if it is there already.
  [[nodiscard]] RadianceField to(at::Device device) const;
  [[nodiscard]] at::Device device() const { return geometry_grid.device(); }

  void save(const std::filesystem::path& path) const;
  /// Throws InputError for a file that is not such a field.
  static RadianceField load(const std::filesystem::path& path);
};

/// Training options. The defaults fit a field in a minute on two cores; configs/paper.toml has the
/// official code's numbers.
struct FieldOptions {
  FieldShape shape;
  int64_t steps = 450;
  int64_t samples_per_step = int64_t{1} << 16;
  int64_t ray_steps = 512;
  double rate = 1e-2;
  int64_t warmup = 500;
  double diffuse_share = 1.0 / 15;
  double mask_weight = 0.1;
  double specular_weight = 1e-5;
  double tv_weight = 1e-8;
  int64_t checkpoint_every = 250;
  at::Device device = at::kCPU;  ///< where it trains; the result lies there

  void keys(KeyList& key) {
    key.group("geometry", shape.geometry);
    key.group("appearance", shape.appearance);
    key("occupancy", shape.occupancy, {16, 512}, "cells",
        "side of the occupancy grid, a multiple of 8");
    key("steps", steps, {1, 1e7}, "", "training steps");
    key("samples_per_step", samples_per_step, {1024, 1 << 24}, "", "samples of a step");
    key("ray_steps", ray_steps, {16, 8192}, "", "steps across the box's diagonal");
    key("rate", rate, {1e-7, 1}, "", "Adam's learning rate at its peak");
    key("warmup", warmup, {0, 1e6}, "steps", "linear warm-up, at most a tenth of all steps");
    key("diffuse_share", diffuse_share, {0, 1}, "", "share of the steps with diffuse colour only");
    key("mask_weight", mask_weight, {0, 1e6}, "", "weight of the mask loss");
    key("specular_weight", specular_weight, {0, 1e6}, "", "weight of the specular part's square");
    key("tv_weight", tv_weight, {0, 1e6}, "", "weight of total variation on the grids");
    key("checkpoint_every", checkpoint_every, {1, 1e7}, "steps", "steps between checkpoints");
  }
};

/// Renders a camera's view: [H,W,4] premultiplied colour and alpha, no gradient.
[[nodiscard]] at::Tensor render_field(const RadianceField& field, const scene::Camera& camera,
                                      double step);

/// Trains a field. `checkpoint` is the file that holds the intermediate state. If it exists, the
/// training continues from it and gives the same bytes as without the stop. Throws InputError for a
/// capture without masks, NumericError if it diverges and every retry fails.
[[nodiscard]] RadianceField fit_field(const capture::Capture& capture, const FieldOptions& options,
                                      uint64_t seed, const std::filesystem::path& checkpoint,
                                      Progress& progress);

/// Step length along rays for these options, e.g. for render_field.
[[nodiscard]] double ray_step(const FieldOptions& options);

}  // namespace tt3d::field
