#pragma once

#include <ATen/ATen.h>

#include <array>
#include <cmath>
#include <map>
#include <numbers>
#include <utility>
#include <vector>

#include "tt3d/core.h"

namespace tt3d::testing {

/// Vertices [V,3] float32 and faces [F,3] int32, counter-clockwise from outside.
struct Shape {
  at::Tensor vertices, faces;
};

inline Shape make_shape(const std::vector<std::array<float, 3>>& v,
                        const std::vector<std::array<int32_t, 3>>& f) {
  return {at::from_blob(const_cast<float*>(v[0].data()), {static_cast<int64_t>(v.size()), 3},
                        at::kFloat)
              .clone(),
          at::from_blob(const_cast<int32_t*>(f[0].data()), {static_cast<int64_t>(f.size()), 3},
                        at::kInt)
              .clone()};
}

/// Closed sphere: an octahedron subdivided `levels` times; 8 * 4^levels faces.
inline Shape sphere(int levels, float radius = 1) {
  std::vector<std::array<float, 3>> v = {{1, 0, 0},  {-1, 0, 0}, {0, 1, 0},
                                         {0, -1, 0}, {0, 0, 1},  {0, 0, -1}};
  std::vector<std::array<int32_t, 3>> f = {{0, 2, 4}, {2, 1, 4}, {1, 3, 4}, {3, 0, 4},
                                           {2, 0, 5}, {1, 2, 5}, {3, 1, 5}, {0, 3, 5}};
  for (int level = 0; level < levels; ++level) {
    std::map<std::pair<int32_t, int32_t>, int32_t> middle;
    const auto midpoint = [&](int32_t a, int32_t b) {
      const auto [it, fresh] =
          middle.try_emplace({std::min(a, b), std::max(a, b)}, static_cast<int32_t>(v.size()));
      if (fresh) {
        std::array<float, 3> m{};
        float norm = 0;
        for (int k = 0; k < 3; ++k) {
          m[k] = v[a][k] + v[b][k];
          norm += m[k] * m[k];
        }
        for (float& x : m) x /= std::sqrt(norm);
        v.push_back(m);
      }
      return it->second;
    };
    std::vector<std::array<int32_t, 3>> next;
    for (const auto& t : f) {
      const int32_t a = midpoint(t[0], t[1]), b = midpoint(t[1], t[2]), c = midpoint(t[2], t[0]);
      next.push_back({t[0], a, c});
      next.push_back({t[1], b, a});
      next.push_back({t[2], c, b});
      next.push_back({a, b, c});
    }
    f = std::move(next);
  }
  for (auto& p : v) {
    for (float& x : p) x *= radius;
  }
  return make_shape(v, f);
}

/// Uniform numbers in [low, high) from a seeded stream.
inline at::Tensor uniform(at::IntArrayRef shape, double low, double high, uint64_t seed) {
  at::Tensor t = at::empty(shape, at::kDouble);
  Random random(seed, "test");
  auto* p = t.mutable_data_ptr<double>();
  for (int64_t i = 0; i < t.numel(); ++i) p[i] = random.uniform(low, high);
  return t;
}

}  // namespace tt3d::testing
