#pragma once

#include <ATen/core/Tensor.h>

#include <filesystem>

#include "tt3d/attack.h"

namespace tt3d {

/// What the views of a step show.
struct Rendering {
  at::Tensor pictures;  ///< [N,4,H,W], premultiplied
  /// The same with the clean colours on the same shape; undefined unless asked for.
  at::Tensor clean;
  at::Tensor normals;  ///< [N,3,H,W], likewise
  at::Tensor colors;   ///< [3,P] colours of the visible surface points
  /// R_rgb: their squared distance to the clean ones, summed over colours and averaged over the
  /// pictures' pixels as a mean squared error (paper, section 3.4).
  at::Tensor rgb;
};

/// The regulariser R: how far the object is from a natural one, beta aside.
class Naturalness {
 public:
  /// Throws InputError for a list of printer's colours that cannot be read or is missing.
  Naturalness(const AttackInput& input, const AttackOptions& options);

  /// True if terms() reads Rendering::clean.
  [[nodiscard]] bool compares_pictures() const;

  struct Terms {
    at::Tensor total;                     ///< weighted sum
    at::Tensor chamfer, laplacian, edge;  ///< R_cd, R_lap, R_edge beyond the clean mesh's
  };
  /// vertices [V,3] where they are.
  [[nodiscard]] Terms terms(const Rendering& shown, const at::Tensor& vertices) const;

 private:
  [[nodiscard]] at::Tensor missing_similarity(const Rendering& shown) const;

  const AttackOptions& options_;
  bool shape_is_free_;
  MeshRegularizer regularizer_;
  at::Tensor rest_;       ///< [V,3]
  double rest_edge_ = 0;  ///< edge term of the clean mesh
  at::Tensor printable_;  ///< [K,3]; undefined unless it counts
};

/// Total variation (Sharif et al., "Accessorize to a crime", CCS 2016) of what was
/// changed, images [N,C,H,W]: the length of the differences to the right and lower neighbour, a
/// mean over pictures, colours and pixels. Smoothed by 1e-4 at 0, where a root has no gradient.
[[nodiscard]] at::Tensor total_variation(const at::Tensor& images);

/// Non-printability score: distance of colors [3,P] to the nearest of printable [K,3], a mean over
/// points. Sharif et al. multiply the distances to all of the list instead, which leaves nothing of
/// a list of dozens; the nearest one is what Thys et al., "Fooling automated surveillance cameras",
/// CVPR workshop 2019, made of it.
[[nodiscard]] at::Tensor non_printability(const at::Tensor& colors, const at::Tensor& printable);

/// Mixes of cyan, magenta and yellow ink at none, half and full coverage, by multiplication:
/// [27,3]. What printability is measured against without a printer's own list.
[[nodiscard]] at::Tensor process_ink_mixes();

/// A printer's colours [K,3] float32 sRGB in [0,1]: a text file with three numbers a line, parted
/// by commas or spaces; '#' begins a comment. Throws InputError with file and line.
[[nodiscard]] at::Tensor load_printer_colors(const std::filesystem::path& path);

/// Each offset [V,3] that is longer than `most` back to that length, in place.
void limit_offsets(const at::Tensor& offsets, double most);

}  // namespace tt3d
