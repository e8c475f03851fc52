#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>

#include "asset/asset_fixtures.h"
#include "support/temporary_folder.h"
#include "tt3d/asset.h"
#include "tt3d/surface.h"

namespace tt3d::asset {
namespace {

bool has_xatlas() {
  const std::string python = std::string(TT3D_SOURCE_DIR) + "/.venv/bin/python";
  return std::filesystem::exists(python) &&
         run_process({python, "-c", "import xatlas"}, 60).exit_code == 0;
}

/// Sets TT3D_PYTHON for a scope.
class PythonOverride {
 public:
  explicit PythonOverride(const std::string& path) { ::setenv("TT3D_PYTHON", path.c_str(), 1); }
  ~PythonOverride() { ::unsetenv("TT3D_PYTHON"); }
};

/// A script in place of Python.
std::string fake_python(const testing::TemporaryFolder& folder, const std::string& body) {
  const auto path = folder / "python";
  write_file_atomic(path, "#!/bin/sh\n" + body + "\n");
  std::filesystem::permissions(path, std::filesystem::perms::owner_all);
  return path.string();
}

/// Counts the texel centres of a `size` x `size` atlas that faces cover: [once, more than once].
/// Sets `seen` for each face that covers a texel.
std::array<int, 2> count_owners(const at::Tensor& uvs, const at::Tensor& uv_faces, int size,
                                std::vector<char>& seen) {
  std::vector<int> owners(static_cast<size_t>(size) * size, 0);
  const auto uv = uvs.accessor<float, 2>();
  const auto faces = uv_faces.accessor<int32_t, 2>();
  for (int64_t f = 0; f < faces.size(0); ++f) {
    double x[3], y[3];
    for (int k = 0; k < 3; ++k) {
      x[k] = double{uv[faces[f][k]][0]} * size;
      y[k] = double{uv[faces[f][k]][1]} * size;
    }
    const double area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]);
    if (area == 0) continue;
    const int right = static_cast<int>(std::max({x[0], x[1], x[2]}));
    const int bottom = static_cast<int>(std::max({y[0], y[1], y[2]}));
    for (int r = static_cast<int>(std::min({y[0], y[1], y[2]})); r <= bottom && r < size; ++r) {
      for (int c = static_cast<int>(std::min({x[0], x[1], x[2]})); c <= right && c < size; ++c) {
        bool inside = true;
        for (int k = 0; k < 3; ++k) {
          const int n = (k + 1) % 3;
          const double side = (x[n] - x[k]) * (r + 0.5 - y[k]) - (y[n] - y[k]) * (c + 0.5 - x[k]);
          inside = inside && side * area > 1e-9 * area * area;
        }
        if (!inside) continue;
        ++owners[static_cast<size_t>(r) * size + c];
        seen[static_cast<size_t>(f)] = 1;
      }
    }
  }
  std::array<int, 2> counts{};
  for (const int n : owners) {
    counts[0] += n == 1 ? 1 : 0;
    counts[1] += n > 1 ? 1 : 0;
  }
  return counts;
}

TEST(Unwrap, ChartsOfASphereDoNotOverlapAndCoverEveryFace) {
  if (!has_xatlas()) GTEST_SKIP() << "xatlas is not installed in .venv";
  const TexturedMesh mesh = testing::bumpy_sphere(16, 24);
  const scene::UvMap map = unwrap(mesh.vertices, mesh.faces, 512, 2, 120);
  EXPECT_GE(map.uvs.min().item<float>(), 0);
  EXPECT_LE(map.uvs.max().item<float>(), 1);
  std::vector<char> seen(static_cast<size_t>(mesh.faces.size(0)));
  const auto [once, more] = count_owners(map.uvs, map.faces, 512, seen);
  EXPECT_EQ(more, 0);
  EXPECT_GT(once, 512 * 512 * 2 / 5);
  const at::Tensor corners = testing::corner_positions(mesh).view({-1, 3, 3});
  const at::Tensor area = at::linalg_cross(corners.select(1, 1) - corners.select(1, 0),
                                           corners.select(1, 2) - corners.select(1, 0))
                              .norm(2, 1);
  for (int64_t f = 0; f < mesh.faces.size(0); ++f) {
    const bool has_area = area[f].item<float>() > 1e-5;
    EXPECT_TRUE(!has_area || seen[static_cast<size_t>(f)]) << f;
  }
}

TEST(Unwrap, TimeLimitMissingToolAndFailure) {
  const TexturedMesh mesh = testing::bumpy_sphere(4, 5);
  testing::TemporaryFolder folder;
  const auto run = [&] { (void)unwrap(mesh.vertices, mesh.faces, 64, 1, 0.5); };
  {
    const PythonOverride python(fake_python(folder, "exec sleep 20"));
    EXPECT_THROW(run(), ResourceError);
  }
  {
    const PythonOverride python(fake_python(folder, "echo needs: pip install xatlas; exit 3"));
    try {
      run();
      FAIL();
    } catch (const MissingToolError& error) {
      EXPECT_NE(std::string(error.what()).find("pip install xatlas"), std::string::npos);
    }
  }
  {
    const PythonOverride python(fake_python(folder, "echo first; echo went wrong; exit 1"));
    try {
      run();
      FAIL();
    } catch (const ResourceError& error) {
      EXPECT_NE(std::string(error.what()).find(": went wrong"), std::string::npos);
    }
  }
  const PythonOverride python((folder / "no-such-python").string());
  EXPECT_THROW(run(), MissingToolError);
}

TEST(Unwrap, MalformedInput) {
  const TexturedMesh mesh = testing::bumpy_sphere(4, 5);
  EXPECT_THROW((void)unwrap(mesh.vertices, mesh.faces + 100, 64, 1, 1), InputError);
  EXPECT_THROW((void)unwrap(mesh.vertices * NAN, mesh.faces, 64, 1, 1), InputError);
  EXPECT_THROW((void)unwrap(mesh.vertices, at::zeros({0, 3}, at::kInt), 64, 1, 1), InputError);
  EXPECT_THROW((void)unwrap({}, {}, 64, 1, 1), InputError);
  EXPECT_THROW((void)unwrap(mesh.vertices, mesh.faces, 0, 1, 1), InputError);
  EXPECT_THROW((void)unwrap(mesh.vertices, mesh.faces, 64, 40, 1), InputError);
}

}  // namespace
}  // namespace tt3d::asset
