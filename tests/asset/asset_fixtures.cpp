#include "asset/asset_fixtures.h"
#include "tt3d/asset.h"

#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numbers>

namespace tt3d::testing {
namespace {

void append_u32(std::string& bytes, size_t value) {
  const auto narrow = static_cast<uint32_t>(value);
  bytes.append(reinterpret_cast<const char*>(&narrow), 4);
}

}  // namespace

asset::TexturedMesh bumpy_sphere(int rings, int sectors) {
  std::vector<float> vertices, uvs;
  std::vector<int32_t> faces, uv_faces;
  for (int r = 0; r <= rings; ++r) {
    const double polar = std::numbers::pi * r / rings;
    for (int s = 0; s <= sectors; ++s) {
      const double azimuth = 2 * std::numbers::pi * (s % sectors) / sectors;
      const double radius = 1 + 0.1 * std::sin(5 * polar) * std::cos(3 * azimuth);
      uvs.push_back(static_cast<float>(s) / static_cast<float>(sectors));
      uvs.push_back(static_cast<float>(r) / static_cast<float>(rings));
      if (s == sectors) continue;
      vertices.push_back(static_cast<float>(1 + radius * std::sin(polar) * std::cos(azimuth)));
      vertices.push_back(static_cast<float>(2 + radius * std::sin(polar) * std::sin(azimuth)));
      vertices.push_back(static_cast<float>(3 + radius * std::cos(polar)));
    }
  }
  for (int r = 0; r < rings; ++r) {
    for (int s = 0; s < sectors; ++s) {
      const int a = r * sectors + s, b = r * sectors + (s + 1) % sectors;
      const int t = r * (sectors + 1) + s, w = sectors + 1;
      faces.insert(faces.end(), {a, a + sectors, b, b, a + sectors, b + sectors});
      uv_faces.insert(uv_faces.end(), {t, t + w, t + 1, t + 1, t + w, t + w + 1});
    }
  }
  asset::TexturedMesh mesh;
  mesh.vertices = at::tensor(vertices).view({-1, 3});
  mesh.faces = at::tensor(faces, at::kInt).view({-1, 3});
  mesh.map.uvs = at::tensor(uvs).view({-1, 2});
  mesh.map.faces = at::tensor(uv_faces, at::kInt).view({-1, 3});
  mesh.texture =
      at::arange(16 * 24 * 3, at::kInt).mul(37).remainder(251).to(at::kByte).view({16, 24, 3});
  return mesh;
}

at::Tensor corner_positions(const asset::TexturedMesh& mesh) {
  return mesh.vertices.index_select(0, mesh.faces.flatten().to(at::kLong));
}

at::Tensor corner_uvs(const asset::TexturedMesh& mesh) {
  return mesh.map.uvs.index_select(0, mesh.map.faces.flatten().to(at::kLong));
}

at::Tensor corner_colours(const asset::TexturedMesh& mesh) {
  const int64_t height = mesh.texture.size(0), width = mesh.texture.size(1);
  const at::Tensor uvs = corner_uvs(mesh);
  const at::Tensor column = (uvs.select(1, 0) * width).floor().clamp(0, width - 1).to(at::kLong);
  const at::Tensor row = (uvs.select(1, 1) * height).floor().clamp(0, height - 1).to(at::kLong);
  return mesh.texture.view({-1, 3}).index_select(0, row * width + column).to(at::kFloat);
}

at::Tensor four_colours() {
  at::Tensor image = at::empty({64, 64, 3}, at::kByte);
  const auto fill = [&](int64_t row, int64_t column, const std::vector<int>& rgb) {
    image.narrow(0, row, 32).narrow(1, column, 32).copy_(at::tensor(rgb, at::kInt));
  };
  fill(0, 0, {220, 30, 30});
  fill(0, 32, {30, 200, 30});
  fill(32, 0, {30, 30, 220});
  fill(32, 32, {230, 220, 40});
  return image;
}

std::array<int, 3> colour_at(const asset::TexturedMesh& mesh, const std::array<double, 3>& point) {
  const at::Tensor p = at::tensor({point[0], point[1], point[2]}, at::kDouble);
  const at::Tensor corners = corner_positions(mesh).to(at::kDouble).view({-1, 3, 3});
  const at::Tensor uvs = corner_uvs(mesh).to(at::kDouble).view({-1, 3, 2});
  for (int64_t i = 0; i < corners.size(0); ++i) {
    // The barycentric coordinates, by least squares.
    const at::Tensor edges =
        at::stack({corners[i][1] - corners[i][0], corners[i][2] - corners[i][0]}, 1);
    const at::Tensor inverse = at::linalg_pinv(edges);
    const at::Tensor bc = at::matmul(inverse, p - corners[i][0]);
    const double b = bc[0].item<double>(), c = bc[1].item<double>();
    const at::Tensor there = corners[i][0] + at::matmul(edges, bc);
    const bool inside = b > -1e-6 && c > -1e-6 && b + c < 1 + 1e-6;
    if (!inside || (there - p).norm().item<double>() > 1e-4) continue;
    const at::Tensor uv = (1 - b - c) * uvs[i][0] + b * uvs[i][1] + c * uvs[i][2];
    const auto texel = [&](int64_t axis, int64_t size) {
      const double at = uv[axis].item<double>() * static_cast<double>(size);
      return std::clamp<int64_t>(static_cast<int64_t>(std::floor(at)), 0, size - 1);
    };
    const at::Tensor rgb =
        mesh.texture[texel(1, mesh.texture.size(0))][texel(0, mesh.texture.size(1))];
    return {rgb[0].item<uint8_t>(), rgb[1].item<uint8_t>(), rgb[2].item<uint8_t>()};
  }
  ADD_FAILURE() << "no face at " << point[0] << " " << point[1] << " " << point[2];
  return {};
}

void expect_colour(const asset::TexturedMesh& mesh, const std::array<double, 3>& point,
                   const std::array<int, 3>& colour, int tolerance) {
  const std::array<int, 3> found = colour_at(mesh, point);
  for (size_t c = 0; c < 3; ++c) {
    EXPECT_NEAR(found[c], colour[c], tolerance)
        << "channel " << c << " at " << point[0] << " " << point[1] << " " << point[2];
  }
}

void expect_four_colours(const asset::TexturedMesh& mesh) {
  expect_colour(mesh, {0.25, 0, 0.75}, {220, 30, 30});
  expect_colour(mesh, {0.75, 0, 0.75}, {30, 200, 30});
  expect_colour(mesh, {0.25, 0, 0.25}, {30, 30, 220});
  expect_colour(mesh, {0.75, 0, 0.25}, {230, 220, 40});
}

double surface_area(const asset::TexturedMesh& mesh) {
  const at::Tensor p = corner_positions(mesh).to(at::kDouble).view({-1, 3, 3});
  const at::Tensor a = p.select(1, 1) - p.select(1, 0), b = p.select(1, 2) - p.select(1, 0);
  return 0.5 * at::linalg_cross(a, b).norm(2, {1}).sum().item<double>();
}

asset::TexturedMesh load_with_notes(const std::filesystem::path& path, std::string& notes) {
  class Notes : public Progress {
   public:
    explicit Notes(std::string& text) : text_(text) {}
    void note(const std::string& line) override { text_ += line + "\n"; }

   private:
    std::string& text_;
  };
  Notes progress(notes);
  return asset::load_asset(path, &progress);
}

std::string make_glb(const nlohmann::json& root, std::string binary) {
  std::string json = root.dump();
  json.resize((json.size() + 3) / 4 * 4, ' ');
  binary.resize((binary.size() + 3) / 4 * 4, '\0');
  std::string glb = "glTF";
  append_u32(glb, 2);
  append_u32(glb, 28 + json.size() + binary.size());
  append_u32(glb, json.size());
  glb += "JSON" + json;
  append_u32(glb, binary.size());
  glb.append("BIN\0", 4);
  return glb + binary;
}

void split_glb(const std::string& bytes, nlohmann::json& root, std::string& binary) {
  uint32_t json_size = 0, binary_size = 0;
  std::memcpy(&json_size, bytes.data() + 12, 4);
  root = nlohmann::json::parse(bytes.substr(20, json_size));
  std::memcpy(&binary_size, bytes.data() + 20 + json_size, 4);
  binary = bytes.substr(28 + json_size, binary_size);
}

std::string asset_error(const std::filesystem::path& path) {
  try {
    (void)asset::load_asset(path);
  } catch (const InputError& error) {
    const std::string text = error.what();
    EXPECT_EQ(text.find('\n'), std::string::npos) << text;
    EXPECT_NE(text.find(path.parent_path().string()), std::string::npos) << text;
    return text;
  }
  return "";
}

}  // namespace tt3d::testing
