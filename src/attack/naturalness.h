#pragma once

#include <ATen/core/Tensor.h>

#include <filesystem>

#include "tt3d/attack.h"
#include "tt3d/mesh.h"

namespace tt3d::attack {

/// The renderings of a step.
struct Rendering {
  at::Tensor pictures;  ///< [N,4,H,W], premultiplied
  /// The same shape with the clean colours; undefined if not needed.
  at::Tensor clean;
  at::Tensor normals;  ///< [N,3,H,W]; undefined if not needed
  at::Tensor colors;   ///< [3,P] colours of the visible surface points
  /// R_rgb: the squared distance of `colors` to the clean colours, summed over the channels and
  /// averaged over the pixels of the pictures (paper, section 3.4).
  at::Tensor rgb;
};

/// The regulariser R (without the factor beta): how far the object is from a natural one.
class Naturalness {
 public:
  /// Throws InputError if the file of printable colours is missing or malformed.
  Naturalness(const AttackInput& input, const AttackOptions& options);

  /// True if terms() reads Rendering::clean.
  [[nodiscard]] bool compares_pictures() const;

  struct Terms {
    at::Tensor total;                     ///< weighted sum
    at::Tensor chamfer, laplacian, edge;  ///< R_cd, R_lap, and R_edge minus that of the clean mesh
  };
  /// vertices [V,3]: the displaced positions.
  [[nodiscard]] Terms terms(const Rendering& shown, const at::Tensor& vertices) const;

 private:
  [[nodiscard]] at::Tensor missing_similarity(const Rendering& shown) const;

  const AttackOptions& options_;
  bool shape_is_free_;
  mesh::MeshRegularizer regularizer_;
  at::Tensor rest_;       ///< [V,3]
  double rest_edge_ = 0;  ///< edge-length term of the clean mesh
  at::Tensor printable_;  ///< [K,3]; undefined if its weight is 0
};

/// Total variation (Sharif et al., "Accessorize to a crime", CCS 2016) of the change, images
/// [N,C,H,W]: the length of the vector of differences to the right and lower neighbour, averaged
/// over pictures, channels and pixels. The root is smoothed by 1e-4, because it has no gradient at
/// 0.
[[nodiscard]] at::Tensor total_variation(const at::Tensor& images);

/// Non-printability score: the distance of colors [3,P] to the nearest of printable [K,3], averaged
/// over points (Thys et al., "Fooling automated surveillance cameras", CVPR workshop 2019). Sharif
/// et al. multiply the distances to all colours of the list; that product vanishes for a list of
/// dozens.
[[nodiscard]] at::Tensor non_printability(const at::Tensor& colors, const at::Tensor& printable);

/// Mixes of cyan, magenta and yellow ink at none, half and full coverage, by multiplication:
/// [27,3]. The default list of printable colours.
[[nodiscard]] at::Tensor process_ink_mixes();

/// Reads the colours of a printer, [K,3] float32 sRGB in [0,1], from a text file. A line has three
/// numbers, separated by commas or spaces; '#' begins a comment. Throws InputError with file and
/// line.
[[nodiscard]] at::Tensor load_printer_colors(const std::filesystem::path& path);

/// Shortens each offset [V,3] that is longer than `most` to that length, in place.
void limit_offsets(const at::Tensor& offsets, double most);

}  // namespace tt3d::attack
