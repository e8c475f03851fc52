#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <filesystem>
#include <memory>
#include <utility>
#include <vector>

#include "tt3d/capture.h"
#include "tt3d/core.h"
#include "tt3d/field.h"
#include "tt3d/keys.h"
#include "tt3d/object.h"
#include "tt3d/raster.h"
#include "tt3d/scene.h"
#include "tt3d/surface.h"

/// From a radiance field to a closed, manifold triangle mesh, refined against the photographs.
/// Meshes: vertices [V,3] float32 in [-1,1]^3, faces [F,3] int32 counter-clockwise from outside.
/// Functions that change the structure of a mesh run on the host and return a mesh on the host.
/// Rendering and regularisers run on the device of their tensors.
namespace tt3d::mesh {
struct Neighbors;

/// Topology of a mesh, from its indices, and its volume.
struct MeshFacts {
  int64_t vertices = 0, faces = 0, edges = 0, components = 0;
  int64_t boundary_edges = 0;      ///< edges with one face
  int64_t non_manifold_edges = 0;  ///< edges with three or more faces, or with two of opposite
                                   ///< orientation
  int64_t euler = 0;               ///< V - E + F: 2 * (components - genus) when closed
  double volume = 0;               ///< signed; positive when faces look outward
  [[nodiscard]] bool closed() const { return boundary_edges == 0 && non_manifold_edges == 0; }
};
[[nodiscard]] MeshFacts inspect(const scene::TriMesh& mesh);

// ---- Extraction ---------------------------------------------------------------------------

/// Marching cubes (Lorensen & Cline 1987) on values [G,G,G], indexed (z,y,x), at the points of a
/// regular grid over [-1,1]^3; inside is value > 0. The result is closed and manifold: both sides
/// cut an ambiguous face the same way, and everything outside the grid counts as outside.
[[nodiscard]] scene::TriMesh marching_cubes(const at::Tensor& values);

/// Fills cavities and narrow tunnels (a closing by reconstruction; Serra 1982): an outside point
/// becomes inside if a cube of 2 * radius + 1 points a side, moved from the border of the grid
/// through outside points, cannot cover it. values as for marching_cubes; in place.
void fill_cavities(const at::Tensor& values, int64_t radius);

/// Removes unused vertices and duplicate, degenerate and back-to-back faces; separates edges with
/// more than two faces. A closed mesh stays closed.
[[nodiscard]] scene::TriMesh repair(const scene::TriMesh& mesh);

/// Closes every hole: one with three edges by a face, a longer one by a fan around its centre.
[[nodiscard]] scene::TriMesh close_holes(const scene::TriMesh& mesh);

/// Removes components whose bounding box has a diagonal shorter than `share` times that of the
/// whole mesh.
[[nodiscard]] scene::TriMesh drop_small_components(const scene::TriMesh& mesh, double share);

/// Quadric simplification (meshoptimizer) to about `target_faces`.
[[nodiscard]] scene::TriMesh simplify(const scene::TriMesh& mesh, int64_t target_faces);

/// Splits the faces of `selected` [F] (bool) into four at the midpoints of their edges, and splits
/// neighbours to match. Edges shorter than `min_edge` are not split.
[[nodiscard]] scene::TriMesh subdivide(const scene::TriMesh& mesh, const at::Tensor& selected,
                                       double min_edge);

/// Simplifies only the faces of `selected` [F] (bool) and keeps about `ratio` of them. The border
/// of the selection stays unchanged.
[[nodiscard]] scene::TriMesh decimate(const scene::TriMesh& mesh, const at::Tensor& selected,
                                      double ratio);

// ---- Rendering ----------------------------------------------------------------------------

/// The topology of a mesh, prepared for rendering.
struct RenderMesh {
  at::Tensor faces;  ///< [F,3]
  at::Tensor twins;  ///< from edge_twins
  explicit RenderMesh(const at::Tensor& mesh_faces);
};

/// Renders views of a mesh. vertices [V,3]: positions. rest [V,3]: the positions that the shader
/// gets, either the same tensor or the undeformed positions; the appearance then moves with the
/// surface. All cameras have the same picture size. Returns [N,H,W,C+1], antialiased at
/// silhouettes: premultiplied colours, alpha, then the rows of the shader after the first three.
/// Differentiable in vertices, rest and the parameters of the shader. `rast_out` receives the
/// rasterisation.
[[nodiscard]] at::Tensor render_mesh(const at::Tensor& vertices, const at::Tensor& rest,
                                     const RenderMesh& mesh,
                                     const std::vector<scene::Camera>& cameras,
                                     const raster::SurfaceShader& shader,
                                     at::Tensor* rast_out = nullptr);

// ---- Regularisers -------------------------------------------------------------------------

/// Weights of the neighbours in the Laplacian of a vertex.
enum class LaplacianWeights {
  kUniform,    ///< equal weights; also makes the triangles more regular
  kCotangent,  ///< (cot a + cot b) / 2 of the angles opposite the edge, in the rest mesh (Pinkall &
               ///< Polthier 1993), clamped to [1e-4, 1e2]. A flat region costs nothing for any
               ///< triangulation.
};
[[nodiscard]] constexpr std::array<std::string_view, 2> enum_names(LaplacianWeights) {
  return {"uniform", "cotangent"};
}

/// Neighbourhoods of a mesh, for the regularisers.
class MeshRegularizer {
 public:
  explicit MeshRegularizer(const scene::TriMesh& rest,
                           LaplacianWeights weights = LaplacianWeights::kUniform);
  /// Mean squared Laplacian (Nealen et al. 2006): |v - weighted mean of its neighbours|^2.
  [[nodiscard]] at::Tensor laplacian(const at::Tensor& vertices) const;
  /// Mean squared edge length (Wang et al., Pixel2Mesh, 2018).
  [[nodiscard]] at::Tensor edge_length(const at::Tensor& vertices) const;
  /// Chamfer distance to the rest vertices: the sum of both means of squared nearest distances.
  /// Exact; a search is skipped only if a vertex is provably still nearest to its own rest
  /// position.
  [[nodiscard]] at::Tensor chamfer(const at::Tensor& vertices) const;

 private:
  struct RestTree;
  [[nodiscard]] std::pair<at::Tensor, at::Tensor> nearest_both_ways(const at::Tensor& moved,
                                                                    const at::Tensor& offset) const;

  at::Tensor rest_;
  std::shared_ptr<const Neighbors> neighbors_;
  at::Tensor degree_;   ///< [V,1] sum of the weights around each vertex
  at::Tensor spacing_;  ///< [V] distance of each rest vertex to the nearest other one
  std::shared_ptr<const RestTree> tree_;
};

// ---- Stages -------------------------------------------------------------------------------

struct MeshOptions {
  int64_t resolution = 192;
  double iso = 10;
  int64_t close_gaps = 1;
  double min_component = 0.05;
  int64_t target_faces = 40000, min_faces = 20000, max_faces = 60000;
  int64_t refine_steps = 200;
  int64_t views_per_step = 2;
  double vertex_rate = 1e-4, appearance_rate = 1e-2;
  double mask_weight = 0.1, laplacian_weight = 1e-3, offset_weight = 0.1;
  std::vector<double> remesh_at = {0.2, 0.4};
  double split_share = 0.1, decimate_share = 0.5, decimate_ratio = 0.5;
  double min_edge = 0.01;
  int64_t checkpoint_every = 100;

  void keys(KeyList& key) {
    key("resolution", resolution, {16, 1024}, "points", "side of the marching-cubes grid");
    key("iso", iso, {1e-3, 1e6}, "",
        "density at the surface; values above the mean density of the field are lowered to it");
    key("close_gaps", close_gaps, {0, 16}, "points",
        "fills cavities, and tunnels too narrow for a cube of 2 n + 1 grid points");
    key("min_component", min_component, {0, 1}, "",
        "components smaller than this share of the diameter are removed");
    key("target_faces", target_faces, {100, 5e6}, "faces", "faces after simplification");
    key("min_faces", min_faces, {0, 5e6}, "faces", "lowest number of faces in refinement");
    key("max_faces", max_faces, {100, 1e7}, "faces", "highest number of faces in refinement");
    key("refine_steps", refine_steps, {0, 1e6}, "", "refinement steps");
    key("views_per_step", views_per_step, {1, 64}, "", "photographs per refinement step");
    key("vertex_rate", vertex_rate, {0, 1}, "", "learning rate of vertex offsets");
    key("appearance_rate", appearance_rate, {0, 1}, "", "learning rate of the appearance");
    key("mask_weight", mask_weight, {0, 1e6}, "", "weight of the mask loss");
    key("laplacian_weight", laplacian_weight, {0, 1e6}, "", "weight of the uniform Laplacian");
    key("offset_weight", offset_weight, {0, 1e6}, "", "weight of the squared vertex offsets");
    key("remesh_at", remesh_at, {0, 1},
        "shares of the steps after which faces are split and decimated");
    key("split_share", split_share, {0, 1}, "",
        "share of the faces that is split: those with the largest error");
    key("decimate_share", decimate_share, {0, 1}, "",
        "share of the faces that is decimated: those with the smallest error");
    key("decimate_ratio", decimate_ratio, {0.01, 1}, "",
        "share of the decimated faces that is kept");
    key("min_edge", min_edge, {0, 1}, "object box / 2", "shorter edges are not split");
    key("checkpoint_every", checkpoint_every, {1, 1e7}, "steps", "steps between checkpoints");
  }
};

/// Marching cubes on the field, then repair and simplification. Throws InputError if the field has
/// no surface.
[[nodiscard]] scene::TriMesh extract_mesh(const field::RadianceField& field,
                                          const MeshOptions& options, Progress& progress);

/// Optimises vertices and appearance against the training photographs. Only the diffuse part of the
/// appearance is optimised, because only this part is exported. Splits the faces with the largest
/// error and decimates those with the smallest. The result is on the device of the appearance.
/// Resumes from `checkpoint` if it exists, with the same result to the byte. Throws NumericError.
[[nodiscard]] object::Object refine_mesh(const scene::TriMesh& mesh,
                                         const field::GridMlp& appearance,
                                         const capture::Capture& capture,
                                         const MeshOptions& options, uint64_t seed,
                                         const std::filesystem::path& checkpoint,
                                         Progress& progress);

}  // namespace tt3d::mesh
