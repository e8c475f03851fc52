#include "tt3d/mesh.h"
#include "tt3d/scene.h"
#include "tt3d/surface.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "support/gradient_check.h"
#include "support/shapes.h"
#include "support/temporary_folder.h"

namespace tt3d::mesh {
namespace {

using at::Tensor;

/// Coordinates of the grid points over [-1,1]^3: x, y, z, each [G,G,G].
std::array<Tensor, 3> grid(int64_t size) {
  const Tensor line = at::linspace(-1, 1, size);
  return {line.view({1, 1, size}).expand({size, size, size}),
          line.view({1, size, 1}).expand({size, size, size}),
          line.view({size, 1, 1}).expand({size, size, size})};
}

Tensor ball(int64_t size, double radius, double cx = 0) {
  const auto [x, y, z] = grid(size);
  return (radius - ((x - cx).square() + y.square() + z.square()).sqrt()).contiguous();
}

scene::TriMesh as_mesh(const testing::Shape& s) { return {s.vertices, s.faces}; }

TEST(ToClip, IsTheMatrixProductWithItsGradients) {
  const Tensor vertices = testing::uniform({17, 3}, -1, 1, 1),
               weight = testing::uniform({3, 17, 4}, -1, 1, 2);
  const Tensor matrices = testing::uniform({3, 4, 4}, -1, 1, 3);
  const auto reference = [&](const Tensor& points) {
    const Tensor ones = at::ones({points.size(0), 1}, points.options());
    return at::matmul(at::cat({points, ones}, 1), matrices.transpose(1, 2));
  };
  const auto sum = [&](const std::vector<Tensor>& in) {
    return (scene::to_clip(in[0], matrices) * weight).sum();
  };
  EXPECT_TRUE(at::allclose(scene::to_clip(vertices, matrices), reference(vertices)));
  EXPECT_LT(testing::gradient_error(sum, {vertices}), 1e-7);
  const Tensor ours = vertices.clone().requires_grad_(true);
  const Tensor plain = vertices.clone().requires_grad_(true);
  sum({ours}).backward();
  (reference(plain) * weight).sum().backward();
  EXPECT_TRUE(at::allclose(ours.grad(), plain.grad()));
  EXPECT_THROW((void)scene::to_clip(vertices, matrices.to(at::kFloat)), c10::Error);
}

TEST(MarchingCubes, BallHasItsVolumeAndGenus) {
  const scene::TriMesh mesh = marching_cubes(ball(64, 0.7));
  const MeshFacts facts = inspect(mesh);
  EXPECT_TRUE(facts.closed());
  EXPECT_EQ(facts.euler, 2);
  EXPECT_EQ(facts.components, 1);
  EXPECT_NEAR(facts.volume, 4.0 / 3 * std::numbers::pi * 0.343, 0.01);
}

TEST(MarchingCubes, TorusHasGenusOne) {
  const auto [x, y, z] = grid(80);
  const Tensor ring = (x.square() + y.square()).sqrt() - 0.6;
  const MeshFacts facts =
      inspect(marching_cubes((0.2 - (ring.square() + z.square()).sqrt()).contiguous()));
  EXPECT_TRUE(facts.closed());
  EXPECT_EQ(facts.euler, 0);
  EXPECT_NEAR(facts.volume, 2 * std::numbers::pi * std::numbers::pi * 0.6 * 0.04, 0.02);
}

TEST(MarchingCubes, NoiseIsClosedAndManifold) {
  // All corner configurations occur, also the ambiguous ones.
  for (const uint64_t seed : {1, 2, 3}) {
    const Tensor values = testing::uniform({20, 20, 20}, -1, 1, seed).to(at::kFloat);
    const MeshFacts facts = inspect(marching_cubes(values));
    EXPECT_EQ(facts.boundary_edges, 0);
    EXPECT_EQ(facts.non_manifold_edges, 0);
    EXPECT_GT(facts.volume, 0);
  }
}

TEST(MarchingCubes, SolidAtTheBorderIsClosedThere) {
  const MeshFacts facts = inspect(marching_cubes(at::ones({4, 4, 4})));
  EXPECT_TRUE(facts.closed());
  EXPECT_EQ(facts.euler, 2);
}

TEST(MarchingCubes, NothingInsideNothingOut) {
  EXPECT_EQ(marching_cubes(-at::ones({4, 4, 4})).faces.size(0), 0);
}

TEST(FillCavities, HollowBallBecomesSolid) {
  Tensor shell = at::minimum(ball(40, 0.8), -ball(40, 0.5)).contiguous();
  EXPECT_EQ(inspect(marching_cubes(shell)).components, 2);
  fill_cavities(shell, 0);
  const MeshFacts facts = inspect(marching_cubes(shell));
  EXPECT_EQ(facts.components, 1);
  EXPECT_NEAR(facts.volume, 4.0 / 3 * std::numbers::pi * 0.512, 0.05);
}

TEST(FillCavities, TunnelsGoWhereNoCubeOfTheRadiusFits) {
  // A hollow ball, with a square tunnel of three grid points per side from its top to its cavity.
  Tensor shell = at::minimum(ball(40, 0.8), -ball(40, 0.5)).contiguous();
  shell.narrow(0, 20, 20).narrow(1, 19, 3).narrow(2, 19, 3).fill_(-1);
  EXPECT_EQ(inspect(marching_cubes(shell)).euler, 2);  // one surface: the cavity is open
  const double bowl = inspect(marching_cubes(shell)).volume;
  Tensor kept = shell.clone();
  fill_cavities(kept, 1);
  EXPECT_NEAR(inspect(marching_cubes(kept)).volume, bowl, 1e-2);
  Tensor filled = shell.clone();
  fill_cavities(filled, 2);
  EXPECT_NEAR(inspect(marching_cubes(filled)).volume, 4.0 / 3 * std::numbers::pi * 0.512, 0.05);
  EXPECT_EQ(inspect(marching_cubes(filled)).components, 1);
}

TEST(FillCavities, WhatACubeCanReachStays) {
  const Tensor solid = ball(40, 0.6);
  Tensor same = solid.clone();
  fill_cavities(same, 2);
  EXPECT_TRUE(at::equal(same, solid));
}

TEST(Components, SmallOnesGo) {
  const Tensor two = at::maximum(ball(64, 0.5, -0.4), ball(64, 0.06, 0.7)).contiguous();
  const scene::TriMesh mesh = marching_cubes(two);
  EXPECT_EQ(inspect(mesh).components, 2);
  EXPECT_EQ(inspect(drop_small_components(mesh, 0.1)).components, 1);
  EXPECT_EQ(inspect(drop_small_components(mesh, 0.01)).components, 2);
}

TEST(Repair, DuplicatesNullAndBackToBackFacesGo) {
  const testing::Shape s = testing::sphere(1);
  const Tensor extra = at::tensor({0, 0, 1, 0, 2, 4, 3, 1, 5, 1, 3, 5}, at::kInt).view({4, 3});
  const scene::TriMesh dirty = {s.vertices, at::cat({s.faces, s.faces.narrow(0, 0, 2), extra})};
  const MeshFacts facts = inspect(repair(dirty));
  EXPECT_EQ(facts.faces, s.faces.size(0) + 1);  // the single extra face 0,2,4 remains
  EXPECT_EQ(inspect(repair({s.vertices, at::cat({s.faces, s.faces})})).faces, s.faces.size(0));
}

TEST(Repair, TwoTetrahedraAtAnEdgeComeApart) {
  // Closed, but four faces share the edge 0-1.
  const std::vector<std::array<float, 3>> v = {{0, 0, 0}, {0, 0, 1},  {1, 0, 0},
                                               {1, 1, 0}, {-1, 0, 0}, {-1, -1, 0}};
  const auto tetrahedron = [](int32_t a, int32_t b, int32_t c, int32_t d) {
    return std::vector<std::array<int32_t, 3>>{{a, b, c}, {a, d, b}, {b, d, c}, {a, c, d}};
  };
  auto f = tetrahedron(0, 1, 2, 3);
  const auto g = tetrahedron(0, 1, 4, 5);
  f.insert(f.end(), g.begin(), g.end());
  const scene::TriMesh mesh = as_mesh(testing::make_shape(v, f));
  EXPECT_EQ(inspect(mesh).non_manifold_edges, 1);
  const MeshFacts facts = inspect(repair(mesh));
  EXPECT_TRUE(facts.closed()) << facts.boundary_edges << " " << facts.non_manifold_edges;
  EXPECT_EQ(facts.faces, 8);
}

TEST(CloseHoles, MissingFacesComeBack) {
  const testing::Shape s = testing::sphere(2);
  Tensor keep = at::ones({s.faces.size(0)}, at::kBool);
  for (const int64_t gone : {3, 40, 41, 42, 43}) keep[gone].fill_(false);
  const scene::TriMesh open = {s.vertices, s.faces.index_select(0, keep.nonzero().flatten())};
  EXPECT_FALSE(inspect(open).closed());
  const MeshFacts facts = inspect(close_holes(open));
  EXPECT_TRUE(facts.closed());
  EXPECT_EQ(facts.euler, 2);
}

TEST(Simplify, SphereStaysClosedNearItsVolume) {
  const scene::TriMesh mesh = as_mesh(testing::sphere(5));
  const scene::TriMesh small = simplify(mesh, 1000);
  const MeshFacts facts = inspect(small);
  EXPECT_LE(facts.faces, 1100);
  EXPECT_TRUE(facts.closed());
  EXPECT_NEAR(facts.volume, 4.18879, 0.06);
}

TEST(Subdivide, SelectionSplitsAndTheMeshStaysClosed) {
  const scene::TriMesh mesh = as_mesh(testing::sphere(3));
  Tensor selected = at::zeros({mesh.faces.size(0)}, at::kBool);
  selected.narrow(0, 10, 40).fill_(true);
  const MeshFacts facts = inspect(subdivide(mesh, selected, 0));
  EXPECT_TRUE(facts.closed());
  EXPECT_GT(facts.faces, mesh.faces.size(0) + 3 * 40);
  EXPECT_EQ(facts.euler, 2);
  EXPECT_EQ(inspect(subdivide(mesh, selected, 10)).faces, mesh.faces.size(0));
}

TEST(Decimate, OnlyTheSelectionThins) {
  const scene::TriMesh mesh = as_mesh(testing::sphere(4));
  const Tensor centre = mesh.vertices.index_select(0, mesh.faces.select(1, 0).to(at::kLong));
  const Tensor upper = centre.select(1, 2) > 0.2;
  const MeshFacts facts = inspect(decimate(mesh, upper, 0.3));
  EXPECT_TRUE(facts.closed());
  EXPECT_LT(facts.faces, mesh.faces.size(0));
  EXPECT_GE(facts.faces, mesh.faces.size(0) - upper.sum().item<int64_t>());
}

TEST(Regularizer, GradientsAgainstCentralDifferences) {
  scene::TriMesh mesh = as_mesh(testing::sphere(1));
  mesh.vertices = mesh.vertices.to(at::kDouble);
  const Tensor moved = mesh.vertices + testing::uniform(mesh.vertices.sizes(), -0.05, 0.05, 4);
  const MeshRegularizer uniform(mesh), cotangent(mesh, LaplacianWeights::kCotangent);
  const auto error = [&](const auto& term) {
    return testing::gradient_error([&](const std::vector<Tensor>& in) { return term(in[0]); },
                                   {moved});
  };
  EXPECT_LT(error([&](const Tensor& v) { return uniform.laplacian(v); }), 1e-6);
  EXPECT_LT(error([&](const Tensor& v) { return cotangent.laplacian(v); }), 1e-6);
  EXPECT_LT(error([&](const Tensor& v) { return uniform.edge_length(v); }), 1e-6);
  EXPECT_LT(error([&](const Tensor& v) { return uniform.chamfer(v); }), 1e-6);
}

TEST(Regularizer, EqualsTheTensorReference) {
  scene::TriMesh mesh = as_mesh(testing::sphere(2));
  mesh.vertices = mesh.vertices.to(at::kDouble);
  const Tensor moved0 = mesh.vertices + testing::uniform(mesh.vertices.sizes(), -0.05, 0.05, 4);
  // Every edge of a closed mesh has two faces, one in each direction.
  const Tensor f = mesh.faces.to(at::kLong);
  const Tensor from = f.flatten(), to = f.roll(-1, 1).flatten();
  std::vector<Tensor> results;
  for (const bool ours : {true, false}) {
    const Tensor v = moved0.clone().requires_grad_(true);
    Tensor laplacian, length;
    if (ours) {
      const MeshRegularizer regularizer(mesh);
      laplacian = regularizer.laplacian(v);
      length = regularizer.edge_length(v);
    } else {
      const Tensor degree =
          at::zeros_like(v).index_add(0, from, at::ones({from.size(0), 3}, v.options()));
      const Tensor sums = at::zeros_like(v).index_add(0, from, v.index_select(0, to));
      laplacian = (v - sums / degree).square().sum(1).mean();
      length = (v.index_select(0, from) - v.index_select(0, to)).square().sum(1).mean();
    }
    (laplacian + 3 * length).backward();
    results.insert(results.end(), {laplacian.detach(), length.detach(), v.grad()});
  }
  for (size_t i = 0; i < 3; ++i) {
    EXPECT_LT((results[i] - results[i + 3]).abs().max().item<double>(), 1e-14) << i;
  }
}

TEST(Regularizer, AVertexWithoutFacesIsLeftAlone) {
  scene::TriMesh mesh = as_mesh(testing::sphere(1));
  const double before = MeshRegularizer(mesh).laplacian(mesh.vertices).item<double>();
  const auto count = static_cast<double>(mesh.vertices.size(0));
  mesh.vertices = at::cat({mesh.vertices, at::full({1, 3}, 5.F)});
  const double after = MeshRegularizer(mesh).laplacian(mesh.vertices).item<double>();
  EXPECT_NEAR(after * (count + 1), before * count, 1e-6);
}

/// A flat fan around the origin: a wide half on the right, a narrow one on the left.
scene::TriMesh uneven_fan() {
  scene::TriMesh fan;
  fan.vertices =
      at::tensor({0.F, 0.F, 0.F, 3.F, 0.F, 0.F, 0.F, 1.F, 0.F, -1.F, 0.F, 0.F, 0.F, -1.F, 0.F})
          .view({5, 3});
  fan.faces = at::tensor({0, 1, 2, 0, 2, 3, 0, 3, 4, 0, 4, 1}, at::kInt).view({4, 3});
  return fan;
}

TEST(Regularizer, CotangentLaplacianByHand) {
  const scene::TriMesh fan = uneven_fan();
  const MeshRegularizer uniform(fan), cotangent(fan, LaplacianWeights::kCotangent);
  // Inner edges to (3,0), (-1,0), (0,+-1): (cot a + cot b) / 2 = 1/3, 1, (3 + 1) / 2. Rim edges:
  // half the cotangent of the right angle at the centre is 0, so they have the least weight.
  const double w1 = 1.0 / 3, w2 = 2, w3 = 1, rim = 1e-4;
  const auto square = [](double x, double y) { return x * x + y * y; };
  const double total = w1 + 2 * w2 + w3;
  const double middle = square((3 * w1 - w3) / total, 0);
  const double right = square(3 - 0 / (w1 + 2 * rim), 0);
  const double left = square(-1 - 0 / (w3 + 2 * rim), 0);
  const double up = square((3 - 1) * rim / (w2 + 2 * rim), 1);
  EXPECT_NEAR(cotangent.laplacian(fan.vertices).item<double>(),
              (middle + right + left + 2 * up) / 5, 1e-5);
  EXPECT_NEAR(middle, 0, 1e-12);
  // Uniform weights pull the centre of this flat fan to the right.
  const double uniform_middle = square(2.0 / 4, 0), uniform_right = square(3, 0),
               uniform_left = square(-1, 0), uniform_up = square(2.0 / 3, 1);
  EXPECT_NEAR(uniform.laplacian(fan.vertices).item<double>(),
              (uniform_middle + uniform_right + uniform_left + 2 * uniform_up) / 5, 1e-5);
}

TEST(Regularizer, LengthOfEdgesByHand) {
  // Four inner edges of length 3, 1, 1, 1, and four rim edges whose squares are 10, 2, 2, 10.
  const MeshRegularizer regularizer(uneven_fan());
  EXPECT_NEAR(regularizer.edge_length(uneven_fan().vertices).item<double>(), (9 + 3 + 24) / 8.0,
              1e-6);
}

TEST(Regularizer, ChamferEqualsTheSearchOfAllPairs) {
  const scene::TriMesh mesh = as_mesh(testing::sphere(3));
  const MeshRegularizer regularizer(mesh);
  for (const double size : {0.001, 0.02, 0.1}) {
    const Tensor shift = testing::uniform(mesh.vertices.sizes(), -size, size, 9).to(at::kFloat);
    const Tensor moved = mesh.vertices + shift * (shift.select(1, 0).unsqueeze(1) > 0);
    const Tensor distance = at::cdist(moved.to(at::kDouble), mesh.vertices.to(at::kDouble));
    const double expected = (std::get<0>(distance.min(1)).square().mean() +
                             std::get<0>(distance.min(0)).square().mean())
                                .item<double>();
    EXPECT_NEAR(regularizer.chamfer(moved).item<double>(), expected, 1e-3 * expected) << size;
  }
}

TEST(Regularizer, ChamferSearchesWhenVerticesTravelFar) {
  const scene::TriMesh mesh = as_mesh(testing::sphere(2));
  const MeshRegularizer regularizer(mesh);
  // A quarter turn maps the set of vertices onto itself: the distance is 0, although every vertex
  // moved.
  const Tensor turned = at::stack(
      {-mesh.vertices.select(1, 1), mesh.vertices.select(1, 0), mesh.vertices.select(1, 2)}, 1);
  EXPECT_LT(regularizer.chamfer(turned).item<double>(), 1e-10);
  EXPECT_NEAR(regularizer.chamfer(mesh.vertices * 1.01).item<double>(), 2e-4, 1e-6);
}

}  // namespace
}  // namespace tt3d::mesh
