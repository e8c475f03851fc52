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
#include "tt3d/raster.h"

/// From a radiance field to a closed, manifold triangle mesh, refined against the photographs.
/// Meshes: vertices [V,3] float32 in [-1,1]^3, faces [F,3] int32 counter-clockwise from outside.
/// Functions that change a mesh's structure work on the host and give a mesh on the host; rendering
/// and regularisers work on the device of their tensors.
namespace tt3d {
namespace mesh {
struct Neighbors;
}

struct TriMesh {
  at::Tensor vertices;  ///< [V,3] float32
  at::Tensor faces;     ///< [F,3] int32
  /// The same on a device, without gradient; shares memory where it is there already.
  [[nodiscard]] TriMesh to(at::Device device) const;
};

/// What a mesh is, counted on its index structure.
struct MeshFacts {
  int64_t vertices = 0, faces = 0, edges = 0, components = 0;
  int64_t boundary_edges = 0;      ///< edges of one face
  int64_t non_manifold_edges = 0;  ///< edges of three or more faces, or of two that disagree
  int64_t euler = 0;               ///< V - E + F: 2 * (components - genus) when closed
  double volume = 0;               ///< signed; positive when faces look outward
  [[nodiscard]] bool closed() const { return boundary_edges == 0 && non_manifold_edges == 0; }
};
[[nodiscard]] MeshFacts inspect(const TriMesh& mesh);

// ---- Extraction ---------------------------------------------------------------------------

/// Marching cubes (Lorensen & Cline 1987) on values [G,G,G] over (z,y,x) at the corners of a
/// regular grid over [-1,1]^3; inside is value > 0. The case table is generated, each ambiguous
/// face is cut the same way from both sides, and the grid counts as surrounded by outside: the
/// result is closed and manifold.
[[nodiscard]] TriMesh marching_cubes(const at::Tensor& values);

/// Sets outside points that a cube of 2 * radius + 1 points a side cannot cover on its way from the
/// grid's border to inside: no hidden inner surfaces, no tunnels too narrow to look through (a
/// closing by reconstruction; Serra 1982). values as for marching_cubes; in place.
void fill_cavities(const at::Tensor& values, int64_t radius);

/// Drops unused vertices, duplicate, null and back-to-back faces; pulls apart edges of more than
/// two faces. A closed mesh stays closed.
[[nodiscard]] TriMesh repair(const TriMesh& mesh);

/// Closes every hole: a rim of three edges by a face, a longer one by a fan around its middle.
[[nodiscard]] TriMesh close_holes(const TriMesh& mesh);

/// Drops components whose bounding box's diagonal is under `share` of the whole mesh's.
[[nodiscard]] TriMesh drop_small_components(const TriMesh& mesh, double share);

/// Quadric simplification (meshoptimizer) to about `target_faces`.
[[nodiscard]] TriMesh simplify(const TriMesh& mesh, int64_t target_faces);

/// Splits the faces of `selected` [F] (bool) into four at their edges' middles; neighbours are
/// split to match. Edges shorter than `min_edge` stay.
[[nodiscard]] TriMesh subdivide(const TriMesh& mesh, const at::Tensor& selected, double min_edge);

/// Simplifies only the faces of `selected` [F] (bool), keeping `ratio` of them; their border stays.
[[nodiscard]] TriMesh decimate(const TriMesh& mesh, const at::Tensor& selected, double ratio);

// ---- Rendering ----------------------------------------------------------------------------

/// A mesh's fixed part, prepared for rendering.
struct RenderMesh {
  at::Tensor faces;  ///< [F,3]
  at::Tensor twins;  ///< from edge_twins
  explicit RenderMesh(const at::Tensor& mesh_faces);
};

/// Views of a mesh: vertices [V,3] where they are, rest [V,3] where the shader looks their points
/// up (the same tensor, or the undeformed positions: the appearance then sticks to the surface).
/// Cameras share one picture size. Returns [N,H,W,C+1], antialiased at silhouettes: premultiplied
/// colours, alpha, then what the shader has beyond three rows. Differentiable in vertices, rest and
/// whatever the shader holds. `rast_out` receives the rasterisation.
[[nodiscard]] at::Tensor render_mesh(const at::Tensor& vertices, const at::Tensor& rest,
                                     const RenderMesh& mesh, const std::vector<Camera>& cameras,
                                     const SurfaceShader& shader, at::Tensor* rast_out = nullptr);

/// World-to-clip matrices of cameras, [N,4,4] float32, with depth range fitted to [-1,1]^3 around
/// the origin times `extent`.
[[nodiscard]] at::Tensor clip_matrices(const std::vector<Camera>& cameras, double extent = 2);
/// vertices [V,3] through matrices [N,4,4] of the same type: clip coordinates [N,V,4].
/// Differentiable with respect to the vertices.
[[nodiscard]] at::Tensor to_clip(const at::Tensor& vertices, const at::Tensor& matrices);

// ---- Regularisers -------------------------------------------------------------------------

/// What a neighbour weighs in a vertex's Laplacian.
enum class LaplacianWeights {
  kUniform,    ///< the same for all: also evens out the triangles
  kCotangent,  ///< (cot a + cot b) / 2 of the angles opposite the edge, at rest (Pinkall & Polthier
               ///< 1993): flat places cost nothing, however they are cut. Kept in [1e-4, 1e2].
};

/// Unit normals of the vertices [V,3]: the mean of the faces around, weighted by area; 0 where
/// there are none. faces [F,3]. Differentiable.
[[nodiscard]] at::Tensor vertex_normals(const at::Tensor& vertices, const at::Tensor& faces);

/// Neighbourhoods of a mesh, for the regularisers.
class MeshRegularizer {
 public:
  explicit MeshRegularizer(const TriMesh& rest,
                           LaplacianWeights weights = LaplacianWeights::kUniform);
  /// Mean squared Laplacian (Nealen et al. 2006): |v - weighted mean of its neighbours|^2.
  [[nodiscard]] at::Tensor laplacian(const at::Tensor& vertices) const;
  /// Mean squared edge length (Wang et al., Pixel2Mesh, 2018).
  [[nodiscard]] at::Tensor edge_length(const at::Tensor& vertices) const;
  /// Chamfer distance to the rest vertices: squared distances to the nearest, both ways, means
  /// added. Exact: where a vertex provably stayed nearest to its own rest place no search is made.
  [[nodiscard]] at::Tensor chamfer(const at::Tensor& vertices) const;

 private:
  struct RestTree;
  [[nodiscard]] std::pair<at::Tensor, at::Tensor> nearest_both_ways(const at::Tensor& moved,
                                                                    const at::Tensor& offset) const;

  at::Tensor rest_;
  std::shared_ptr<const mesh::Neighbors> neighbors_;
  at::Tensor degree_;   ///< [V,1] sum of the weights around each vertex
  at::Tensor spacing_;  ///< [V] distance of each rest vertex to the nearest other one
  std::shared_ptr<const RestTree> tree_;
};

// ---- Stages -------------------------------------------------------------------------------

struct MeshOptions {
  int64_t resolution = 256;      ///< grid points a side for marching cubes
  double iso = 10;               ///< density of the surface, at most the field's mean
  int64_t close_gaps = 1;        ///< grid points; radius of fill_cavities
  double min_component = 0.05;   ///< share of the diameter below which components go
  int64_t target_faces = 40000;  ///< after simplification
  int64_t refine_steps = 400;
  int64_t views_per_step = 2;
  double vertex_rate = 1e-4;      ///< Adam's learning rate of vertex offsets
  double appearance_rate = 1e-2;  ///< of the appearance's parameters
  double mask_weight = 0.1;
  double laplacian_weight = 1e-3;
  double offset_weight = 0.1;
  std::vector<double> remesh_at = {0.2, 0.4};  ///< shares of the steps
  double split_share = 0.1;                    ///< faces with the worst error that are split
  double decimate_share = 0.5;                 ///< faces with the best error that are thinned
  double decimate_ratio = 0.5;                 ///< share of those that is kept
  double min_edge = 0.01;                      ///< edges are not split below this
  int64_t max_faces = 60000, min_faces = 20000;
  int64_t checkpoint_every = 100;
};

/// Marching cubes on the field, cleaned and simplified. Throws InputError when nothing is solid.
[[nodiscard]] TriMesh extract_mesh(const RadianceField& field, const MeshOptions& options,
                                   Progress& progress);

/// A refined mesh and the diffuse appearance fitted with it.
struct RefinedMesh {
  TriMesh mesh;
  GridMlp appearance;
};

/// Optimises vertices and appearance (its diffuse part alone: what is exported) against the
/// training photographs; splits faces with the worst error and thins those with the best. Works on
/// the appearance's device, and leaves the result there.
/// Resumes from `checkpoint` if it exists, to the same bytes. Throws NumericError.
[[nodiscard]] RefinedMesh refine_mesh(const TriMesh& mesh, const GridMlp& appearance,
                                      const Capture& capture, const MeshOptions& options,
                                      uint64_t seed, const std::filesystem::path& checkpoint,
                                      Progress& progress);

/// Binary PLY, vertices and faces only, positions mapped by the inverse of `normalization`.
void write_ply(const TriMesh& mesh, const Normalization& normalization,
               const std::filesystem::path& path);

}  // namespace tt3d
