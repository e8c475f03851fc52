#pragma once

#include <ATen/core/Tensor.h>
#include <c10/core/Device.h>

#include <memory>
#include <string>
#include <utility>
#include <vector>

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

/// The appearance that a file's tensors hold; faces [F,3] int32 of its mesh. Throws InputError.
[[nodiscard]] std::unique_ptr<Appearance> read_appearance(const TensorFile& file,
                                                          const at::Tensor& faces);

}  // namespace tt3d
