#include <ATen/ATen.h>
#include <unistd.h>

#include <cstdlib>

#include "tt3d/bake.h"
#include "tt3d/core.h"
#include "tt3d/tensor_file.h"

namespace tt3d {
namespace fs = std::filesystem;

namespace {

constexpr int kExitNoXatlas = 3;  ///< as in unwrap.py

/// A folder for the exchange with the child, removed at the end of the scope.
class ExchangeFolder {
 public:
  ExchangeFolder() {
    std::string pattern = (fs::temp_directory_path() / "tt3d-unwrap-XXXXXX").string();
    if (::mkdtemp(pattern.data()) == nullptr) {
      throw ResourceError(pattern +
                          ": cannot create a temporary folder; set TMPDIR to one that "
                          "can be written");
    }
    path_ = pattern;
  }
  ~ExchangeFolder() {
    std::error_code ignored;
    fs::remove_all(path_, ignored);
  }
  ExchangeFolder(const ExchangeFolder&) = delete;
  ExchangeFolder& operator=(const ExchangeFolder&) = delete;
  fs::path operator/(const char* name) const { return path_ / name; }

 private:
  fs::path path_;
};

std::string find_python() {
  const char* chosen = std::getenv("TT3D_PYTHON");
  if (chosen != nullptr && *chosen != '\0') return chosen;
  const fs::path own = fs::path(TT3D_SOURCE_TREE) / ".venv/bin/python";
  return fs::exists(own) ? own.string() : "python3";
}

/// unwrap.py of the source tree, or where 'cmake --install' put it beside the running program.
fs::path find_script() {
  const fs::path script = "python/tt3d_tools/unwrap.py";
  const fs::path own = TT3D_SOURCE_TREE / script;
  std::error_code error;
  const fs::path program = fs::read_symlink("/proc/self/exe", error);
  const fs::path installed = program.parent_path().parent_path() / "share/tt3d" / script;
  for (const fs::path& place : {own, installed}) {
    if (fs::exists(place, error)) return place;
  }
  throw MissingToolError("UV unwrapping needs " + script.filename().string() + ", expected as " +
                         own.string() + " or " + installed.string() +
                         "; install tt3d with 'cmake --install'");
}

std::string last_line(const std::string& output) {
  const size_t end = output.find_last_not_of(" \n");
  if (end == std::string::npos) return "no message";
  const size_t start = output.find_last_of('\n', end);
  return output.substr(start + 1, end - start);
}

void run_unwrap(const fs::path& input, const fs::path& output, int resolution, int padding,
                double time_limit_seconds) {
  const std::string python = find_python();
  const ProcessResult result =
      run_process({python, find_script().string(), input.string(), output.string(),
                   std::to_string(resolution), std::to_string(padding)},
                  time_limit_seconds);
  if (result.timed_out) {
    throw ResourceError("UV unwrapping took longer than " +
                        std::to_string(std::lround(time_limit_seconds)) +
                        " s; simplify the mesh or raise the limit");
  }
  if (result.exit_code == kExitNoXatlas) {
    throw MissingToolError("UV unwrapping needs the Python package xatlas; install it with '" +
                           python + " -m pip install xatlas'");
  }
  if (result.exit_code != 0) {
    throw ResourceError("UV unwrapping failed (exit code " + std::to_string(result.exit_code) +
                        "): " + last_line(result.output));
  }
}

/// Every face must have a place in the atlas.
Atlas read_atlas(const fs::path& path, int64_t face_count, int resolution) {
  const TensorFile file = load_tensors(path);
  Atlas atlas{file.get("uvs", {-1, 2}, at::kFloat), file.get("uv_faces", {face_count, 3}, at::kInt),
              resolution, resolution};
  const bool inside = atlas.uvs.ge(0).logical_and(atlas.uvs.le(1)).all().item<bool>() &&
                      atlas.uv_faces.ge(0).all().item<bool>() &&
                      atlas.uv_faces.lt(atlas.uvs.size(0)).all().item<bool>();
  if (!inside) throw ResourceError("UV unwrapping gave coordinates outside the atlas");
  return atlas;
}

}  // namespace

Atlas unwrap(const at::Tensor& vertices, const at::Tensor& faces, int resolution, int padding,
             double time_limit_seconds) {
  if (resolution < 16 || resolution > 16384 || padding < 0 || padding > resolution / 4) {
    throw InputError(
        "UV atlas: expected a resolution of 16 to 16384 texels and a padding of at "
        "most a quarter of it");
  }
  // The checks of a mesh, with uvs standing in.
  check_mesh({vertices, faces,
              vertices.defined() && vertices.dim() == 2
                  ? vertices.narrow(1, 0, std::min<int64_t>(2, vertices.size(1)))
                  : vertices,
              faces, at::zeros({1, 1, 3}, at::kByte)},
             "mesh to unwrap");
  const ExchangeFolder folder;
  const fs::path input = folder / "mesh.safetensors";
  const fs::path output = folder / "atlas.safetensors";
  save_tensors(input, {{"vertices", vertices}, {"faces", faces}}, {});
  run_unwrap(input, output, resolution, padding, time_limit_seconds);
  return read_atlas(output, faces.size(0), resolution);
}

}  // namespace tt3d
