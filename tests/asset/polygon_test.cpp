#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "asset/asset_source.h"

// Polygons of OBJ faces become triangles.

namespace tt3d::asset {
namespace {

using Corners = std::vector<std::array<double, 3>>;

struct Areas {
  double sum = 0;     ///< of the triangles' areas
  double vector = 0;  ///< length of the sum of their vector areas: the polygon's area if planar
};

Areas areas_of(const Corners& corners, const std::vector<std::array<size_t, 3>>& triangles) {
  Areas areas;
  std::array<double, 3> total{};
  for (const auto& [a, b, c] : triangles) {
    std::array<double, 3> cross{};
    for (size_t k = 0; k < 3; ++k) {
      const size_t u = (k + 1) % 3, v = (k + 2) % 3;
      cross[k] = (corners[b][u] - corners[a][u]) * (corners[c][v] - corners[a][v]) -
                 (corners[b][v] - corners[a][v]) * (corners[c][u] - corners[a][u]);
      total[k] += cross[k];
    }
    areas.sum += 0.5 * std::hypot(cross[0], cross[1], cross[2]);
  }
  areas.vector = 0.5 * std::hypot(total[0], total[1], total[2]);
  return areas;
}

void expect_area(const Corners& corners, double area) {
  const auto triangles = triangulate(corners);
  ASSERT_TRUE(triangles.has_value());
  EXPECT_EQ(triangles->size(), corners.size() - 2);
  const Areas areas = areas_of(corners, *triangles);
  EXPECT_NEAR(areas.sum, area, 1e-9 * area);
  EXPECT_NEAR(areas.vector, area, 1e-9 * area);
}

/// Turns a polygon of the x-y plane into a slanted plane far from the origin.
Corners slanted(const Corners& corners) {
  Corners result;
  for (const auto& [x, y, z] : corners) {
    result.push_back({7000 + 0.6 * x - 0.48 * y, -300 + 0.8 * x + 0.36 * y, 0.8 * y});
  }
  return result;
}

TEST(Polygon, FansStayFans) {
  const auto square = triangulate({{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}});
  const std::vector<std::array<size_t, 3>> fan = {{0, 1, 2}, {0, 2, 3}};
  EXPECT_EQ(*square, fan);
  // Concave, but its first corner sees all of it.
  EXPECT_EQ(*triangulate({{0, 0, 0}, {2, -1, 0}, {0.5, 0, 0}, {2, 1, 0}}), fan);
  EXPECT_NE(*triangulate({{2, -1, 0}, {0.5, 0, 0}, {2, 1, 0}, {0, 0, 0}}), fan);
}

TEST(Polygon, ConcaveFromEveryCorner) {
  const Corners shape = {{0, 0, 0}, {2, 0, 0}, {2, 1, 0}, {1, 1, 0}, {1, 2, 0}, {0, 2, 0}};
  Corners turned = shape;
  for (size_t i = 0; i < shape.size(); ++i) {
    expect_area(turned, 3);
    expect_area(slanted(turned), 3);
    expect_area(Corners(turned.rbegin(), turned.rend()), 3);
    std::rotate(turned.begin(), turned.begin() + 1, turned.end());
  }
}

TEST(Polygon, CornersOnALine) {
  expect_area(slanted({{0, 0, 0},
                       {1, 0, 0},
                       {2, 0, 0},
                       {2, 1, 0},
                       {2, 2, 0},
                       {1, 2, 0},
                       {1, 1.5, 0},
                       {1, 1, 0},
                       {0.5, 1, 0},
                       {0, 1, 0},
                       {0, 0.5, 0}}),
              3);
}

TEST(Polygon, HoleWithABridge) {
  // A square of side 4 with a square hole of side 1; the bridge runs both ways.
  const Corners shape = {{0, 0, 0}, {4, 0, 0}, {4, 4, 0}, {0, 4, 0}, {0, 0, 0},
                         {1, 1, 0}, {1, 2, 0}, {2, 2, 0}, {2, 1, 0}, {1, 1, 0}};
  expect_area(shape, 15);
  expect_area(slanted(shape), 15);
}

TEST(Polygon, CombOfManyTeeth) {
  Corners comb;
  constexpr int kTeeth = 2000;
  for (int i = 0; i < kTeeth; ++i) {
    comb.push_back({double(i), 1, 0});
    comb.push_back({i + 0.5, 0.1, 0});
  }
  comb.push_back({double(kTeeth), 1, 0});
  comb.push_back({double(kTeeth), 0, 0});
  comb.push_back({0, 0, 0});
  // Each notch is a triangle of width 1 and depth 0.9.
  expect_area(comb, kTeeth * (1 - 0.45));
}

TEST(Polygon, Spiral) {
  Corners spiral;
  constexpr int kSteps = 200;
  const auto at = [](int i, double radius) {
    const double angle = 0.1 * i;
    return std::array<double, 3>{(radius + angle) * std::cos(angle),
                                 (radius + angle) * std::sin(angle), 0};
  };
  for (int i = 0; i < kSteps; ++i) spiral.push_back(at(i, 4));
  for (int i = kSteps; i-- > 0;) spiral.push_back(at(i, 2));
  const auto triangles = triangulate(spiral);
  const Areas areas = areas_of(spiral, *triangles);
  EXPECT_NEAR(areas.sum, areas.vector, 1e-9 * areas.vector);
}

TEST(Polygon, DegenerateShapesBecomeFans) {
  const Corners point(5, {1, 2, 3});
  EXPECT_EQ(triangulate(point)->size(), 3);
  const Corners line = {{0, 0, 0}, {1, 1, 1}, {2, 2, 2}, {1, 1, 1}};
  EXPECT_EQ(triangulate(line)->size(), 2);
  const Corners bow_tie = {{0, 0, 0}, {3, 3, 0}, {3, 0, 0}, {0, 1, 0}, {1, 5, 0}};
  EXPECT_EQ(triangulate(bow_tie)->size(), 3);
}

TEST(Polygon, VeryLongPolygons) {
  Corners circle;
  for (int i = 0; i < 100000; ++i) {
    const double angle = 2 * std::numbers::pi * i / 100000;
    circle.push_back({std::cos(angle), std::sin(angle), 0});
  }
  expect_area(circle, 0.5 * 100000 * std::sin(2 * std::numbers::pi / 100000));
  std::rotate(circle.begin(), circle.begin() + 5, circle.end());
  circle[50000] = {0.999, 0.01, 0};
  EXPECT_EQ(triangulate(circle), std::nullopt);
}

}  // namespace
}  // namespace tt3d::asset
