#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>

#include "run_files.h"
#include "tt3d/json.h"
#include "tt3d/run.h"

/// Stages field and mesh: from photographs or an imported asset to the clean object.
namespace tt3d::run {
namespace fs = std::filesystem;
using at::Tensor;

namespace {

double object_psnr(const object::Object& object, const capture::Capture& capture,
                   Progress& progress) {
  const mesh::RenderMesh prepared(object.mesh.faces);
  const Tensor& vertices = object.mesh.vertices;
  at::NoGradGuard guard;
  return capture::mean_psnr(
      capture.test,
      [&](const scene::Camera& camera) {
        return mesh::render_mesh(
            vertices, vertices, prepared, {camera},
            [&](const raster::SurfacePoints& p) { return object.appearance->color(p); })[0];
      },
      progress);
}

/// Normalises the asset and merges vertices that texture seams had split, so that the surface does
/// not tear when they move.
object::Object object_of(const asset::TexturedMesh& asset, const scene::Normalization& n) {
  const Tensor placed = relative_to(asset.origin, n).to_inside(asset.vertices);
  const auto [vertices, number, count] = at::unique_dim(placed, 0, true, /*return_inverse=*/true);
  const Tensor faces =
      number.index_select(0, asset.faces.flatten().to(at::kLong)).view({-1, 3}).to(at::kInt);
  // Merging can leave faces without area.
  const auto same = [&](int64_t i, int64_t k) { return faces.select(1, i) == faces.select(1, k); };
  const Tensor kept = (~(same(0, 1) | same(1, 2) | same(2, 0))).nonzero().flatten();
  scene::UvMap map = {asset.map.uvs, asset.map.faces.index_select(0, kept)};
  return {{vertices.contiguous(), faces.index_select(0, kept)},
          std::make_shared<object::TextureAppearance>(asset.texture.to(at::kFloat) / 255,
                                                      std::move(map), object::Part::kTexture),
          {}};
}

scene::Placement placement_of(const asset::TexturedMesh& asset, const fs::path& path) {
  scene::Placement placement;
  placement.frame = asset::view_frame(asset, path);
  const auto& c = placement.frame.centre;
  const auto up = placement.frame.up;
  const Tensor centre = at::tensor({c[0], c[1], c[2]}, at::kDouble);
  const double radius = (asset.vertices.to(at::kDouble) - centre).norm(2, {1}).max().item<double>();
  placement.normalization = {1 / radius, placement.frame.centre};
  for (size_t k = 0; k < 3; ++k) placement.normalization.centre[k] += asset.origin[k];
  placement.frame = {{0, 0, 0},
                     placement.frame.radius / radius,
                     placement.frame.distance / radius,
                     placement.frame.fov_y_deg};
  // The frame of the views is upright inside.
  placement.normalization.up = up;
  return placement;
}

/// Notes what falls outside what the meshes of the shipped captures have: 29.6 to 33 dB, one piece,
/// Euler characteristic -36 to 2 (README).
void warn_of_mesh(const mesh::MeshFacts& facts, double psnr, Progress& progress) {
  constexpr double kLeastPsnr = 26;
  constexpr int64_t kLeastEuler = -80;
  std::string found, remedy;
  const auto add = [&](const std::string& text, const std::string& what) {
    found += (found.empty() ? "" : ", ") + text;
    remedy += (remedy.empty() ? "" : "; ") + what;
  };
  if (psnr > 0 && psnr < kLeastPsnr) {
    add("PSNR " + std::to_string(std::lround(psnr)) + " dB (good captures: 29 or more)",
        "look at the masks and cameras with 'tt3d info CAPTURE' or 'tt3d photos'");
  }
  if (facts.components > 1) {
    add(std::to_string(facts.components) + " pieces (1)", "raise mesh.min_component");
  }
  if (facts.euler < kLeastEuler) {
    add("Euler characteristic " + std::to_string(facts.euler) + " (-36 to 2), so many small holes",
        "train longer (field.steps), or raise mesh.close_gaps");
  }
  if (!found.empty()) progress.note("the mesh has " + found + "; " + remedy);
}

}  // namespace

scene::Placement Run::placement(Progress& progress) {
  const fs::path& path = config_.asset.path;
  if (from_asset()) return placement_of(assets_.load(path, &progress), path);
  const capture::Capture& photos = photographs(progress);
  return {photos.normalization, capture::capture_view_frame(photos)};
}

object::Object Run::clean_object() const {
  return object::load_object(folder_ / "mesh" / "mesh.safetensors");
}

void Run::run_field(Progress& progress) {
  const fs::path folder = folder_ / "field";
  const capture::Capture& photos = photographs(progress);
  field::FieldOptions options = config_.field;
  options.device = device_;
  const field::RadianceField field =
      field::fit_field(photos, options, config_.seed, folder / kCheckpoint, progress);
  const double step = field::ray_step(config_.field);
  const double psnr = capture::mean_psnr(
      photos.test,
      [&](const scene::Camera& camera) { return field::render_field(field, camera, step); },
      progress);
  field.save(folder / "field.safetensors");
  write_json(folder / "metrics.json",
             to_json(record::FieldMetrics{psnr, static_cast<int64_t>(photos.test.size())}));
}

void Run::run_mesh(Progress& progress) {
  if (from_asset()) return import_asset(progress);
  const capture::Capture& photos = photographs(progress);
  const field::RadianceField field =
      field::RadianceField::load(folder_ / "field" / "field.safetensors").to(device_);
  const object::Object object =
      mesh::refine_mesh(mesh::extract_mesh(field, config_.mesh, progress), field.appearance, photos,
                        config_.mesh, config_.seed, folder_ / "mesh" / kCheckpoint, progress);
  const double psnr = object_psnr(object, photos, progress);
  save_mesh_stage(object, photos.normalization, psnr);
  warn_of_mesh(mesh::inspect(object.mesh), psnr, progress);
}

void Run::import_asset(Progress& progress) {
  const fs::path& path = config_.asset.path;
  const asset::TexturedMesh& asset = assets_.load(path, &progress);
  add_inputs(asset.files);
  const scene::Normalization normalization = placement_of(asset, path).normalization;
  save_mesh_stage(object_of(asset, normalization), normalization, std::nullopt);
}

void Run::save_mesh_stage(const object::Object& object, const scene::Normalization& normalization,
                          std::optional<double> psnr) {
  const fs::path folder = folder_ / "mesh";
  const mesh::MeshFacts facts = mesh::inspect(object.mesh);
  object::save_object(object, folder / "mesh.safetensors");
  const std::array<double, 3> origin = origin_of(normalization);
  asset::write_ply(
      {relative_to(origin, normalization).to_world(object.mesh.vertices), object.mesh.faces},
      folder / "mesh.ply", origin);
  write_json(
      folder / "metrics.json",
      to_json(record::MeshMetrics{facts.faces, facts.vertices, facts.components,
                                  facts.non_manifold_edges, facts.euler, facts.closed(), psnr}));
}

}  // namespace tt3d::run
