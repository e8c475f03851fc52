#pragma once

#include <ATen/core/Tensor.h>

#include <memory>

namespace tt3d::mesh {

/// Each vertex's neighbours along the edges of a mesh.
struct Neighbors {
  at::Tensor begin;   ///< [V+1] int64, first entry of each vertex's list
  at::Tensor vertex;  ///< [2 E] int32
  at::Tensor weight;  ///< [2 E] in the vertices' dtype; undefined if all are 1

  /// edges [E,2] int64, each once; weights [E] or undefined. All on `like`'s device.
  Neighbors(const at::Tensor& edges, const at::Tensor& weights, int64_t vertices,
            const at::TensorOptions& like);
  [[nodiscard]] int64_t edges() const { return vertex.size(0) / 2; }
};

/// sum over neighbours n of w (x[v] - x[n]): x [V,3] -> [V,3]. Differentiable.
[[nodiscard]] at::Tensor neighbor_differences(const at::Tensor& x,
                                              const std::shared_ptr<const Neighbors>& neighbors);

/// Mean of the squared edge lengths, without weights. Differentiable.
[[nodiscard]] at::Tensor mean_squared_edge(const at::Tensor& x,
                                           const std::shared_ptr<const Neighbors>& neighbors);

}  // namespace tt3d::mesh
