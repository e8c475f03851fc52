#include <ATen/ATen.h>

#include <charconv>

#include "tt3d/asset.h"
#include "tt3d/core.h"
#include "tt3d/image.h"
#include "tt3d/version.h"

namespace tt3d::asset {
namespace {

/// Appends the shortest text that parses to the same number.
template <typename T>
void append_number(std::string& text, T value) {
  char digits[32];
  const auto result = std::to_chars(digits, digits + sizeof digits, value);
  text.append(digits, result.ptr);
}

void append_vertices(std::string& text, const at::Tensor& vertices,
                     const std::array<double, 3>& origin) {
  const bool moved = origin != std::array{0.0, 0.0, 0.0};
  const float* v = vertices.const_data_ptr<float>();
  for (int64_t i = 0; i < vertices.size(0); ++i, v += 3) {
    text += 'v';
    for (size_t a = 0; a < 3; ++a) {
      text += ' ';
      if (moved) {
        append_number(text, origin[a] + double{v[a]});
      } else {
        append_number(text, v[a]);
      }
    }
    text += '\n';
  }
}

/// OBJ measures v from the bottom of the picture.
void append_uvs(std::string& text, const at::Tensor& uvs) {
  const float* t = uvs.const_data_ptr<float>();
  for (int64_t i = 0; i < uvs.size(0); ++i, t += 2) {
    text += "vt ";
    append_number(text, t[0]);
    text += ' ';
    append_number(text, 1 - t[1]);
    text += '\n';
  }
}

void append_faces(std::string& text, const at::Tensor& faces, const at::Tensor& uv_faces) {
  const int32_t* f = faces.const_data_ptr<int32_t>();
  const int32_t* g = uv_faces.const_data_ptr<int32_t>();
  for (int64_t i = 0; i < faces.numel(); ++i) {
    text += i % 3 == 0 ? "f " : " ";
    append_number(text, f[i] + 1);
    text += '/';
    append_number(text, g[i] + 1);
    if (i % 3 == 2) text += '\n';
  }
}

}  // namespace

void write_obj(const TexturedMesh& mesh, const std::filesystem::path& path) {
  check_mesh(mesh, path);
  std::filesystem::path material = path;
  std::filesystem::path picture = path;
  material.replace_extension(".mtl");
  picture.replace_extension(".png");
  std::string text = "# tt3d ";
  text += kVersion;
  text += ", +Z up\nmtllib " + material.filename().string() + "\n";
  append_vertices(text, mesh.vertices.cpu().contiguous(), mesh.origin);
  append_uvs(text, mesh.map.uvs.cpu().contiguous());
  text += "usemtl baked\n";
  append_faces(text, mesh.faces.cpu().contiguous(), mesh.map.faces.cpu().contiguous());
  // The OBJ is written last: when it exists, the files that it names exist too.
  write_file_atomic(picture, image::encode_png(mesh.texture));
  write_file_atomic(material, "newmtl baked\nKa 1 1 1\nKd 1 1 1\nKs 0 0 0\nillum 1\nmap_Kd " +
                                  picture.filename().string() + "\n");
  write_file_atomic(path, text);
}

}  // namespace tt3d::asset
