#pragma once

#include <ATen/core/Tensor.h>
#include <c10/core/Device.h>

#include <array>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "tt3d/core.h"
#include "tt3d/enums.h"
#include "tt3d/field.h"
#include "tt3d/raster.h"
#include "tt3d/surface.h"
#include "tt3d/tensor_file.h"

/// The appearance of a surface: a function from surface points to colours. Its parameters are in
/// named groups; an attack optimises some groups (attack.optimize).
namespace tt3d::object {

/// Parts of an object that an attack may change: the names that attack.optimize takes.
enum class Part {
  kGrid,          ///< hash grid of a field's appearance
  kMlp,           ///< MLP of a field's appearance
  kVertexColors,  ///< a colour for each vertex
  kTexture,       ///< a texture over the whole surface
  kTile,          ///< a small texture that repeats
  kMaterial,      ///< reflectance of the shaded surface
  kNormals,       ///< shading normals of the shaded surface
  kLights,        ///< environment light of the shaded surface
  kVertices,      ///< the shape
};
[[nodiscard]] constexpr std::array<std::string_view, 9> enum_names(Part) {
  return {"grid",     "mlp",     "vertex-colors", "texture", "tile",
          "material", "normals", "lights",        "vertices"};
}

/// Parameters that are optimised together.
struct ParameterGroup {
  Part part;
  std::vector<at::Tensor> tensors;
};

class Appearance {
 public:
  virtual ~Appearance() = default;
  /// sRGB colours [3,P] in [0,1] of points on the rest surface. Differentiable in the parameters,
  /// and in the points if they require a gradient.
  [[nodiscard]] virtual at::Tensor color(const raster::SurfacePoints& points) const = 0;
  /// All parameters, in a fixed order.
  [[nodiscard]] virtual std::vector<ParameterGroup> groups() const = 0;
  /// Clamps parameters to their range after a step.
  virtual void constrain() const {}
  /// A deep copy, without gradient.
  [[nodiscard]] virtual std::unique_ptr<Appearance> clone() const = 0;
  /// A copy on a device, without gradient; shares memory if it is already there.
  [[nodiscard]] virtual std::unique_ptr<Appearance> to(at::Device device) const = 0;
  /// The same parameters on another object; null if they cannot be used on another object.
  [[nodiscard]] virtual std::unique_ptr<Appearance> applied_to(const scene::TriMesh& other) const;
  /// The named tensors from which read_appearance restores it.
  [[nodiscard]] virtual std::vector<std::pair<std::string, at::Tensor>> tensors() const = 0;

  /// The tensors of all groups, in order.
  [[nodiscard]] std::vector<at::Tensor> parameters() const;
};

/// The hash grid and MLP of a field, evaluated at the surface points. Groups "grid" and "mlp".
class GridMlpAppearance final : public Appearance {
 public:
  explicit GridMlpAppearance(field::GridMlp network) : network_(std::move(network)) {}
  [[nodiscard]] at::Tensor color(const raster::SurfacePoints& points) const override;
  [[nodiscard]] std::vector<ParameterGroup> groups() const override;
  [[nodiscard]] std::unique_ptr<Appearance> clone() const override;
  [[nodiscard]] std::unique_ptr<Appearance> to(at::Device device) const override;
  [[nodiscard]] std::vector<std::pair<std::string, at::Tensor>> tensors() const override;

 private:
  field::GridMlp network_;
};

/// One colour per vertex, interpolated over the triangles: the mesh-based baseline of the paper
/// (table 1, after Xiao et al., MeshAdv, CVPR 2019). Group "vertex-colors".
class VertexColorAppearance final : public Appearance {
 public:
  /// colors [V,3] in [0,1]; faces [F,3] int32 of the mesh.
  VertexColorAppearance(at::Tensor colors, at::Tensor faces)
      : colors_(std::move(colors)), faces_(std::move(faces)) {}
  /// The colours of another appearance at the vertices of `mesh`.
  [[nodiscard]] static std::unique_ptr<Appearance> sample(const Appearance& other,
                                                          const scene::TriMesh& mesh);
  [[nodiscard]] at::Tensor color(const raster::SurfacePoints& points) const override;
  [[nodiscard]] std::vector<ParameterGroup> groups() const override;
  void constrain() const override;
  [[nodiscard]] std::unique_ptr<Appearance> clone() const override;
  [[nodiscard]] std::unique_ptr<Appearance> to(at::Device device) const override;
  [[nodiscard]] std::vector<std::pair<std::string, at::Tensor>> tensors() const override;

 private:
  at::Tensor colors_, faces_;
};

/// A texture over a UV map (Athalye et al., "Synthesizing robust adversarial examples", ICML 2018).
/// If the uvs leave [0,1], the texture repeats, like the tile of Suryanto et al., DTA, CVPR 2022.
/// One group, "texture" or "tile".
class TextureAppearance final : public Appearance {
 public:
  /// texels [H,W,3] sRGB in [0,1].
  TextureAppearance(at::Tensor texels, scene::UvMap map, Part part)
      : texels_(std::move(texels)), map_(std::move(map)), part_(part) {}
  [[nodiscard]] at::Tensor color(const raster::SurfacePoints& points) const override;
  [[nodiscard]] std::vector<ParameterGroup> groups() const override { return {{part_, {texels_}}}; }
  void constrain() const override;
  [[nodiscard]] std::unique_ptr<Appearance> clone() const override;
  [[nodiscard]] std::unique_ptr<Appearance> to(at::Device device) const override;
  [[nodiscard]] std::vector<std::pair<std::string, at::Tensor>> tensors() const override;

 private:
  at::Tensor texels_;
  scene::UvMap map_;
  Part part_;
};

/// Triplanar mapping: a tile is projected along the three axes and blended by the surface normal,
/// so one tile fits any object (Suryanto et al., ACTIVE, ICCV 2023). Group "tile".
class TriplanarAppearance final : public Appearance {
 public:
  /// tile [S,S,3] sRGB in [0,1]; normals [V,3] of the rest surface and its faces [F,3]; `repeats`:
  /// tiles along the side of the box [-1,1].
  TriplanarAppearance(at::Tensor tile, at::Tensor normals, at::Tensor faces, double repeats)
      : tile_(std::move(tile)),
        normals_(std::move(normals)),
        faces_(std::move(faces)),
        repeats_(repeats) {}
  [[nodiscard]] at::Tensor color(const raster::SurfacePoints& points) const override;
  [[nodiscard]] std::vector<ParameterGroup> groups() const override {
    return {{Part::kTile, {tile_}}};
  }
  void constrain() const override;
  [[nodiscard]] std::unique_ptr<Appearance> clone() const override;
  [[nodiscard]] std::unique_ptr<Appearance> to(at::Device device) const override;
  [[nodiscard]] std::unique_ptr<Appearance> applied_to(const scene::TriMesh& other) const override;
  [[nodiscard]] std::vector<std::pair<std::string, at::Tensor>> tensors() const override;

 private:
  at::Tensor tile_, normals_, faces_;
  double repeats_;
};

/// Another appearance under light: its colours, times a material per vertex, times the irradiance
/// at the surface normal in a quadratic environment (lighting.h). The same physical parameters
/// change in Zeng et al., "Adversarial attacks beyond the image space", CVPR 2019. At the start the
/// material is white and the light even, so it equals the other appearance. Groups "material",
/// "normals" and "lights".
class ShadedAppearance final : public Appearance {
 public:
  /// normals [V,3] of the rest surface, faces [F,3].
  static std::unique_ptr<Appearance> evenly_lit(std::shared_ptr<const Appearance> base,
                                                const at::Tensor& normals, const at::Tensor& faces);
  /// material [V,3] >= 0; normals [V,3] of any length; lights [9,3], one row per irradiance term.
  ShadedAppearance(std::shared_ptr<const Appearance> base, at::Tensor material, at::Tensor normals,
                   at::Tensor lights, at::Tensor faces)
      : base_(std::move(base)),
        material_(std::move(material)),
        normals_(std::move(normals)),
        lights_(std::move(lights)),
        faces_(std::move(faces)) {}
  [[nodiscard]] at::Tensor color(const raster::SurfacePoints& points) const override;
  [[nodiscard]] std::vector<ParameterGroup> groups() const override;
  void constrain() const override;
  [[nodiscard]] std::unique_ptr<Appearance> clone() const override;
  [[nodiscard]] std::unique_ptr<Appearance> to(at::Device device) const override;
  [[nodiscard]] std::vector<std::pair<std::string, at::Tensor>> tensors() const override;

 private:
  std::shared_ptr<const Appearance> base_;
  at::Tensor material_, normals_, lights_, faces_;
};

/// One appearance on some triangles and another on the rest. The second one never changes. Groups:
/// those of the first.
class MaskedAppearance final : public Appearance {
 public:
  /// mask [F] bool: the triangles that show `inside`.
  MaskedAppearance(std::unique_ptr<Appearance> inside, std::shared_ptr<const Appearance> outside,
                   at::Tensor mask)
      : inside_(std::move(inside)), outside_(std::move(outside)), mask_(std::move(mask)) {}
  [[nodiscard]] at::Tensor color(const raster::SurfacePoints& points) const override;
  [[nodiscard]] std::vector<ParameterGroup> groups() const override { return inside_->groups(); }
  void constrain() const override { inside_->constrain(); }
  [[nodiscard]] std::unique_ptr<Appearance> clone() const override;
  [[nodiscard]] std::unique_ptr<Appearance> to(at::Device device) const override;
  [[nodiscard]] std::vector<std::pair<std::string, at::Tensor>> tensors() const override;

 private:
  std::unique_ptr<Appearance> inside_;
  std::shared_ptr<const Appearance> outside_;
  at::Tensor mask_;
};

/// Fits the appearance of a field to the colours of another appearance on a mesh. The dual attack
/// starts from it if the object does not come from a field. Each step compares the colours at 2^14
/// new random points, uniform over the surface. Resumes from `checkpoint` if it exists.
[[nodiscard]] std::unique_ptr<GridMlpAppearance> fit_grid_mlp(
    const Appearance& target, const scene::TriMesh& mesh, const field::FieldShape& shape,
    uint64_t seed, int64_t steps, const std::filesystem::path& checkpoint, Progress& progress);
/// Random points of a mesh, uniform over its surface. They depend on the key of `random` alone.
[[nodiscard]] raster::SurfacePoints sample_surface(const scene::TriMesh& mesh, int64_t count,
                                                   Random random);

/// Values [V,C] at a mesh's vertices, interpolated at surface points: [C,P].
[[nodiscard]] at::Tensor at_points(const at::Tensor& values, const raster::SurfacePoints& points,
                                   const at::Tensor& faces);

/// Restores the appearance from the tensors of a file; faces [F,3] int32 of its mesh. Throws
/// InputError.
[[nodiscard]] std::unique_ptr<Appearance> read_appearance(const TensorFile& file,
                                                          const at::Tensor& faces);

}  // namespace tt3d::object
