#pragma once

#include <ATen/core/Tensor.h>
#include <c10/core/Device.h>

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "tt3d/core.h"
#include "tt3d/field.h"
#include "tt3d/mesh.h"
#include "tt3d/raster.h"
#include "tt3d/tensor_file.h"

/// The look of a surface as an attack sees it: surface points in, colours out, and the parameters
/// behind them in named groups, of which an attack frees some (attack.optimize).
namespace tt3d {

/// Parameters that are optimised together or not at all.
struct ParameterGroup {
  std::string name;  ///< as attack.optimize has it
  std::vector<at::Tensor> tensors;
};

class Appearance {
 public:
  virtual ~Appearance() = default;
  /// sRGB colours [3,P] in [0,1] of points on the rest surface. Differentiable in the parameters
  /// and, where the points ask for it, in them.
  [[nodiscard]] virtual at::Tensor color(const SurfacePoints& points) const = 0;
  /// All parameters, in a fixed order.
  [[nodiscard]] virtual std::vector<ParameterGroup> groups() const = 0;
  /// Brings parameters that a step has taken out of their range back to its border.
  virtual void constrain() const {}
  /// A deep copy, without gradient.
  [[nodiscard]] virtual std::unique_ptr<Appearance> clone() const = 0;
  /// The same on a device, without gradient; shares memory where it is there already.
  [[nodiscard]] virtual std::unique_ptr<Appearance> to(at::Device device) const = 0;
  /// The same parameters on another object; null for a look that belongs to its own.
  [[nodiscard]] virtual std::unique_ptr<Appearance> worn_by(const TriMesh& other) const;
  /// What read_appearance makes it of, by name.
  [[nodiscard]] virtual std::vector<std::pair<std::string, at::Tensor>> tensors() const = 0;

  /// The tensors of all groups, in order.
  [[nodiscard]] std::vector<at::Tensor> parameters() const;
};

/// The field's hash grid and MLP, looked up where the points lie. Groups "grid" and "mlp".
class GridMlpAppearance final : public Appearance {
 public:
  explicit GridMlpAppearance(GridMlp network) : network_(std::move(network)) {}
  [[nodiscard]] at::Tensor color(const SurfacePoints& points) const override;
  [[nodiscard]] std::vector<ParameterGroup> groups() const override;
  [[nodiscard]] std::unique_ptr<Appearance> clone() const override;
  [[nodiscard]] std::unique_ptr<Appearance> to(at::Device device) const override;
  [[nodiscard]] std::vector<std::pair<std::string, at::Tensor>> tensors() const override;

 private:
  GridMlp network_;
};

/// A colour a vertex, blended over the triangles: the mesh-based baseline of the paper (table 1,
/// after Xiao et al., MeshAdv, CVPR 2019). Group "vertex-colors".
class VertexColorAppearance final : public Appearance {
 public:
  /// colors [V,3] in [0,1]; faces [F,3] int32 of the mesh that is shown.
  VertexColorAppearance(at::Tensor colors, at::Tensor faces)
      : colors_(std::move(colors)), faces_(std::move(faces)) {}
  /// The colours that `look` has at the vertices of `mesh`.
  [[nodiscard]] static std::unique_ptr<Appearance> sample(const Appearance& look,
                                                          const TriMesh& mesh);
  [[nodiscard]] at::Tensor color(const SurfacePoints& points) const override;
  [[nodiscard]] std::vector<ParameterGroup> groups() const override;
  void constrain() const override;
  [[nodiscard]] std::unique_ptr<Appearance> clone() const override;
  [[nodiscard]] std::unique_ptr<Appearance> to(at::Device device) const override;
  [[nodiscard]] std::vector<std::pair<std::string, at::Tensor>> tensors() const override;

 private:
  at::Tensor colors_, faces_;
};

/// Where a surface lies in a texture.
struct TextureMap {
  at::Tensor uvs;       ///< [T,2] float32, (0,0) the top-left corner of the texture; it repeats
  at::Tensor uv_faces;  ///< [F,3] int32 into uvs
  [[nodiscard]] TextureMap to(at::Device device) const;
};

/// A texture over a map: Athalye et al., "Synthesizing robust adversarial examples", ICML 2018.
/// Where the map's uvs reach beyond [0,1] the texture repeats, as the tile of Suryanto et al., DTA,
/// CVPR 2022. One group, "texture" or "tile".
class TextureAppearance final : public Appearance {
 public:
  /// texels [H,W,3] sRGB in [0,1].
  TextureAppearance(at::Tensor texels, TextureMap map, std::string part)
      : texels_(std::move(texels)), map_(std::move(map)), part_(std::move(part)) {}
  [[nodiscard]] at::Tensor color(const SurfacePoints& points) const override;
  [[nodiscard]] std::vector<ParameterGroup> groups() const override { return {{part_, {texels_}}}; }
  void constrain() const override;
  [[nodiscard]] std::unique_ptr<Appearance> clone() const override;
  [[nodiscard]] std::unique_ptr<Appearance> to(at::Device device) const override;
  [[nodiscard]] std::vector<std::pair<std::string, at::Tensor>> tensors() const override;

 private:
  at::Tensor texels_;
  TextureMap map_;
  std::string part_;
};

/// A tile seen along the three axes and blended by the surface's normal (triplanar mapping; as
/// Suryanto et al., ACTIVE, ICCV 2023, have it), so that one tile fits any object. Group "tile".
class TriplanarAppearance final : public Appearance {
 public:
  /// tile [S,S,3] sRGB in [0,1]; normals [V,3] of the rest surface and its faces [F,3]; `repeats`:
  /// tiles along the side of the box [-1,1].
  TriplanarAppearance(at::Tensor tile, at::Tensor normals, at::Tensor faces, double repeats)
      : tile_(std::move(tile)),
        normals_(std::move(normals)),
        faces_(std::move(faces)),
        repeats_(repeats) {}
  [[nodiscard]] at::Tensor color(const SurfacePoints& points) const override;
  [[nodiscard]] std::vector<ParameterGroup> groups() const override { return {{"tile", {tile_}}}; }
  void constrain() const override;
  [[nodiscard]] std::unique_ptr<Appearance> clone() const override;
  [[nodiscard]] std::unique_ptr<Appearance> to(at::Device device) const override;
  [[nodiscard]] std::unique_ptr<Appearance> worn_by(const TriMesh& other) const override;
  [[nodiscard]] std::vector<std::pair<std::string, at::Tensor>> tensors() const override;

 private:
  at::Tensor tile_, normals_, faces_;
  double repeats_;
};

/// Another look under light: its colours times a material a vertex times the irradiance that a
/// quadratic environment gives the surface's normal (lighting.h). After Zeng et al., "Adversarial
/// attacks beyond the image space", CVPR 2019, who change the same physical parameters. It starts
/// white and evenly lit, so as the look itself. Groups "material", "normals" and "lights".
class ShadedAppearance final : public Appearance {
 public:
  /// normals [V,3] of the rest surface, faces [F,3].
  static std::unique_ptr<Appearance> evenly_lit(std::shared_ptr<const Appearance> look,
                                                const at::Tensor& normals, const at::Tensor& faces);
  /// material [V,3] >= 0; normals [V,3] of any length; lights [9,3], a row a term of irradiance.
  ShadedAppearance(std::shared_ptr<const Appearance> look, at::Tensor material, at::Tensor normals,
                   at::Tensor lights, at::Tensor faces)
      : look_(std::move(look)),
        material_(std::move(material)),
        normals_(std::move(normals)),
        lights_(std::move(lights)),
        faces_(std::move(faces)) {}
  [[nodiscard]] at::Tensor color(const SurfacePoints& points) const override;
  [[nodiscard]] std::vector<ParameterGroup> groups() const override;
  void constrain() const override;
  [[nodiscard]] std::unique_ptr<Appearance> clone() const override;
  [[nodiscard]] std::unique_ptr<Appearance> to(at::Device device) const override;
  [[nodiscard]] std::vector<std::pair<std::string, at::Tensor>> tensors() const override;

 private:
  std::shared_ptr<const Appearance> look_;
  at::Tensor material_, normals_, lights_, faces_;
};

/// One appearance on some triangles, and another, which stays as it is to the last bit, on the
/// rest. Groups: the first one's.
class MaskedAppearance final : public Appearance {
 public:
  /// mask [F] bool: the triangles that show `inside`.
  MaskedAppearance(std::unique_ptr<Appearance> inside, std::shared_ptr<const Appearance> outside,
                   at::Tensor mask)
      : inside_(std::move(inside)), outside_(std::move(outside)), mask_(std::move(mask)) {}
  [[nodiscard]] at::Tensor color(const SurfacePoints& points) const override;
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

/// A field's appearance with the colours that `look` has on a mesh: what the dual attack starts
/// from on an object that never was a field. Colours are compared at random points of the surface,
/// evenly spread, a fresh 2^14 a step.
[[nodiscard]] std::unique_ptr<GridMlpAppearance> fit_grid_mlp(const Appearance& look,
                                                              const TriMesh& mesh,
                                                              const FieldShape& shape,
                                                              uint64_t seed, int64_t steps,
                                                              Progress& progress);
/// Random points of a mesh, evenly spread over its surface; keyed by (seed, stream, step).
[[nodiscard]] SurfacePoints sample_surface(const TriMesh& mesh, int64_t count, Random random);

/// The appearance that a file's tensors hold; faces [F,3] int32 of its mesh. Throws InputError.
[[nodiscard]] std::unique_ptr<Appearance> read_appearance(const TensorFile& file,
                                                          const at::Tensor& faces);

}  // namespace tt3d
