#include <ATen/ATen.h>
#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "tt3d/bake.h"
#include "tt3d/report.h"
#include "tt3d/run.h"

namespace tt3d {
namespace fs = std::filesystem;
using at::Tensor;
using nlohmann::json;

namespace {

/// The frame's cameras in the input's coordinates.
ViewFrame world_frame(const Scene& scene) {
  ViewFrame frame = scene.frame;
  const Normalization& n = scene.normalization;
  for (int k = 0; k < 3; ++k) frame.centre[k] = frame.centre[k] / n.scale + n.centre[k];
  frame.radius /= n.scale;
  frame.distance /= n.scale;
  return frame;
}

Tensor to_world(const Tensor& vertices, const Normalization& n) {
  const Tensor centre = at::tensor({n.centre[0], n.centre[1], n.centre[2]}, at::kDouble);
  return (vertices.to(at::kDouble) / n.scale + centre).to(at::kFloat).contiguous();
}

/// A camera of the normalised frame in the input's coordinates.
Camera world_camera(Camera camera, const Normalization& n) {
  for (int k = 0; k < 3; ++k) {
    double& x = camera.camera_to_world[4 * k + 3];
    x = x / n.scale + n.centre[k];
  }
  return camera;
}

void write_json(const fs::path& path, const json& j) { write_file_atomic(path, j.dump(1) + "\n"); }

/// An attack's result that changed nothing: how the refined mesh is stored.
AttackResult as_result(const RefinedMesh& refined) {
  return {refined.mesh, std::make_shared<GridMlpAppearance>(refined.appearance), {}, {}};
}

double mesh_psnr(const RefinedMesh& r, const Capture& capture, Progress& progress) {
  const RenderMesh prepared(r.mesh.faces);
  at::NoGradGuard guard;
  return mean_psnr(
      capture.test,
      [&](const Camera& camera) {
        return render_mesh(
            r.mesh.vertices, r.mesh.vertices, prepared, {camera},
            [&](const SurfacePoints& p) { return r.appearance.color(p.positions); })[0];
      },
      progress);
}

json facts_json(const MeshFacts& facts) {
  return {{"faces", facts.faces},           {"vertices", facts.vertices},
          {"closed", facts.closed()},       {"non_manifold_edges", facts.non_manifold_edges},
          {"components", facts.components}, {"euler", facts.euler}};
}

/// Beside the mesh that it belongs to.
constexpr const char* kAtlas = "mesh/atlas.safetensors";

/// What a look shows, at an atlas's texels: [H,W,3] uint8.
Tensor bake_look(const Atlas& atlas, const TriMesh& rest, const Appearance& look,
                 at::Device device) {
  const auto there = look.to(device);
  return bake_texture(atlas, rest.vertices, rest.faces, [&](const SurfacePoints& p) {
    return there->color({p.positions.to(device), p.rast.to(device)}).cpu();
  });
}

/// Where the surface lies in a texture, and its clean colours there.
void add_texture_map(Atlas atlas, const AttackResult& clean, int64_t size, at::Device device,
                     AttackInput& input) {
  atlas.width = atlas.height = static_cast<int>(size);
  input.map = TextureMap{atlas.uvs, atlas.uv_faces}.to(device);
  input.texels = bake_look(atlas, clean.mesh, *clean.appearance, device).to(device);
}

/// The asset as an attack takes it: normalised, and vertices that seams of the texture had split
/// are one again, so that the surface does not tear where they move.
AttackResult normalized_object(const TexturedMesh& asset, const Normalization& n) {
  const Tensor centre = at::tensor({n.centre[0], n.centre[1], n.centre[2]}, at::kDouble);
  const Tensor placed = ((asset.vertices.to(at::kDouble) - centre) * n.scale).to(at::kFloat);
  const auto [vertices, number, count] = at::unique_dim(placed, 0, true, /*return_inverse=*/true);
  const Tensor faces =
      number.index_select(0, asset.faces.flatten().to(at::kLong)).view({-1, 3}).to(at::kInt);
  // Welding may have left faces without an area.
  const auto same = [&](int64_t i, int64_t k) { return faces.select(1, i) == faces.select(1, k); };
  const Tensor kept = (~(same(0, 1) | same(1, 2) | same(2, 0))).nonzero().flatten();
  TextureMap map = {asset.uvs, asset.uv_faces.index_select(0, kept)};
  AttackResult object;
  object.mesh = {vertices.contiguous(), faces.index_select(0, kept)};
  object.appearance = std::make_shared<TextureAppearance>(asset.texture.to(at::kFloat) / 255,
                                                          std::move(map), "texture");
  return object;
}

Scene asset_scene(const TexturedMesh& asset, const fs::path& path) {
  Scene scene;
  scene.frame = asset_view_frame(asset, path);
  const auto& c = scene.frame.centre;
  const Tensor centre = at::tensor({c[0], c[1], c[2]}, at::kDouble);
  const double radius = (asset.vertices.to(at::kDouble) - centre).norm(2, {1}).max().item<double>();
  scene.normalization = {1 / radius, scene.frame.centre};
  scene.frame = {
      {0, 0, 0}, scene.frame.radius / radius, scene.frame.distance / radius, scene.frame.fov_y_deg};
  return scene;
}

}  // namespace

std::string class_of_objective(const RunConfig& config) {
  const bool targeted = config.attack.goal == "targeted";
  const std::string& name = targeted ? config.attack_target : config.true_class;
  if (!name.empty()) return name;
  throw InputError(targeted ? "attack.target: expected a class"
                            : "evaluate.true_class: expected the object's class, which an "
                              "untargeted attack leads away from");
}

Atlas Run::atlas(const TriMesh& mesh) const {
  const fs::path path = folder_ / kAtlas;
  const Tensor wanted = at::tensor({config_.bake_resolution, config_.bake_padding}, at::kLong);
  if (fs::exists(path)) {
    const TensorFile file = load_tensors(path);
    if (at::equal(file.get("size", {2}, at::kLong), wanted)) {
      return {file.get("uvs", {-1, 2}, at::kFloat),
              file.get("uv_faces", {mesh.faces.size(0), 3}, at::kInt), config_.bake_resolution,
              config_.bake_resolution};
    }
  }
  const Atlas cut = unwrap(mesh.vertices, mesh.faces, config_.bake_resolution, config_.bake_padding,
                           config_.unwrap_time_limit);
  save_tensors(path, {{"uvs", cut.uvs}, {"uv_faces", cut.uv_faces}, {"size", wanted}},
               {{"format", "tt3d atlas"}});
  return cut;
}

Scene Run::scene(Progress& progress) {
  if (!config_.asset.empty()) return asset_scene(load_asset(config_.asset), config_.asset);
  const Capture& photos = capture(progress);
  return {capture_view_frame(photos), photos.normalization};
}

void Run::take_asset(Progress& /*progress*/) {
  const fs::path folder = folder_ / "mesh";
  const TexturedMesh asset = load_asset(config_.asset);
  input_hashes_[fs::absolute(config_.asset).string()] = sha256_file(config_.asset);
  const Normalization n = asset_scene(asset, config_.asset).normalization;
  const AttackResult object = normalized_object(asset, n);
  const MeshFacts facts = inspect(object.mesh);
  save_attack(object, folder / "mesh.safetensors");
  fs::remove(folder_ / kAtlas);  // of another mesh
  write_ply(object.mesh, n, folder / "mesh.ply");
  write_json(folder / "metrics.json", facts_json(facts));
}

void Run::run_field(Progress& progress) {
  const fs::path folder = folder_ / "field";
  const Capture& photos = capture(progress);
  const fs::path checkpoint = folder / "checkpoint.safetensors";
  FieldOptions options = config_.field;
  options.device = device_;
  const RadianceField field = fit_field(photos, options, config_.seed, checkpoint, progress);
  const double step = ray_step(config_.field);
  const double psnr = mean_psnr(
      photos.test, [&](const Camera& camera) { return render_field(field, camera, step); },
      progress);
  field.save(folder / "field.safetensors");
  write_json(folder / "metrics.json", {{"psnr_test", psnr}, {"test_views", photos.test.size()}});
  fs::remove(checkpoint);
}

void Run::run_mesh(Progress& progress) {
  const fs::path folder = folder_ / "mesh";
  const Capture& photos = capture(progress);
  const RadianceField field =
      RadianceField::load(folder_ / "field" / "field.safetensors").to(device_);
  const fs::path checkpoint = folder / "checkpoint.safetensors";
  const TriMesh extracted = extract_mesh(field, config_.mesh, progress);
  const RefinedMesh refined = refine_mesh(extracted, field.appearance, photos, config_.mesh,
                                          config_.seed, checkpoint, progress);
  const MeshFacts facts = inspect(refined.mesh);
  const double psnr = mesh_psnr(refined, photos, progress);
  save_attack(as_result(refined), folder / "mesh.safetensors");
  fs::remove(folder_ / kAtlas);  // of another mesh
  write_ply(refined.mesh, photos.normalization, folder / "mesh.ply");
  json metrics = facts_json(facts);
  metrics["psnr_test"] = psnr;
  write_json(folder / "metrics.json", metrics);
  fs::remove(checkpoint);
}

AttackInput Run::attack_input(Progress& progress) {
  const AttackResult clean = load_attack(folder_ / "mesh" / "mesh.safetensors");
  AttackInput input;
  input.mesh = clean.mesh.to(device_);
  input.appearance = clean.appearance->to(device_);
  input.frame = scene(progress).frame;
  if (!config_.asset.empty() && needs_grid_mlp(config_.attack)) {
    constexpr int64_t kSteps = 300;
    input.appearance = fit_grid_mlp(*input.appearance, input.mesh, config_.field.shape,
                                    config_.seed, kSteps, progress);
  }
  if (needs_texture_map(config_.attack)) {
    add_texture_map(atlas(clean.mesh), clean, config_.attack.texture_size, device_, input);
  }
  return input;
}

void Run::save_attack_files(const AttackResult& result) const {
  const fs::path folder = folder_ / "attack";
  save_attack(result, folder / "attack.safetensors");
  write_file_atomic(folder / "curves.csv", curves_csv(result.curves));
  if (!result.epochs.empty()) write_file_atomic(folder / "epochs.csv", epochs_csv(result.epochs));
}

void Run::run_attack_stage(Progress& progress) {
  const std::string wanted = class_of_objective(config_);
  AttackInput input = attack_input(progress);
  for (const std::string& name : config_.attack_surrogates) {
    const auto model = Classifier::load(name, {}, &progress);
    model->check_gradients();
    input.classes.push_back(find_class(wanted, model->card()).index);
    input_hashes_[model->card().name + ".pt2"] = model->card().sha256;
    input.surrogates.push_back(model);
  }
  std::vector<Run> others;
  for (const std::string& name : config_.attack_also) {
    others.push_back(Run::open(name));
    if (!others.back().done("mesh"))
      throw InputError(name, "has no mesh yet; 'tt3d mesh' makes it");
    others.back().use_device(device_);
    input.also.push_back(others.back().attack_input(progress));
    input.also.back().surrogates = input.surrogates;
    input.also.back().classes = input.classes;
  }
  const fs::path checkpoint = folder_ / "attack" / "checkpoint.safetensors";
  const AttackResult result = run_attack(input, config_.attack, config_.seed, checkpoint, progress);
  save_attack_files(result);
  for (size_t i = 0; i < others.size(); ++i) {
    others[i].adopt_attack(*this, worn_result(result, input.also[i]));
  }
  fs::remove(checkpoint);
}

void Run::run_bake(Progress& progress) {
  const fs::path folder = folder_ / "asset";
  const Scene placed = scene(progress);
  const Normalization& n = placed.normalization;
  const AttackResult clean = load_attack(folder_ / "mesh" / "mesh.safetensors");
  const AttackResult adversarial = load_attack(folder_ / "attack" / "attack.safetensors");
  progress.begin("bake", 3, 0);
  const Atlas map = atlas(clean.mesh);
  progress.update(1, {});
  write_view_frame(world_frame(placed), folder);
  int64_t done = 1;
  for (const auto& [name, result] :
       {std::pair{"clean", &clean}, std::pair{"adversarial", &adversarial}}) {
    progress.check();
    TexturedMesh asset;
    asset.vertices = to_world(result->mesh.vertices, n);
    asset.faces = result->mesh.faces;
    asset.uvs = map.uvs;
    asset.uv_faces = map.uv_faces;
    // Colours sit on the rest surface, which the clean mesh is.
    asset.texture = bake_look(map, clean.mesh, *result->appearance, device_);
    write_glb(asset, folder / (std::string(name) + ".glb"));
    write_obj(asset, folder / (std::string(name) + ".obj"));
    progress.update(++done, {});
  }
  progress.end();
  if (!config_.asset.empty()) return;  // without photographs to compare with
  const Capture& photos = capture(progress);
  const AssetRenderer renderer(load_asset(folder / "clean.glb"), device_);
  const double psnr = mean_psnr(
      photos.test,
      [&](const Camera& camera) { return renderer.render({world_camera(camera, n)})[0]; },
      progress);
  json metrics = json::parse(read_file(folder_ / "mesh" / "metrics.json"));
  metrics["psnr_test_baked"] = psnr;
  write_json(folder_ / "mesh" / "metrics.json", metrics);
}

void Run::run_evaluate(Progress& progress) {
  EvaluateOptions options;
  options.asset = folder_ / "asset" / "adversarial.glb";
  options.clean = folder_ / "asset" / "clean.glb";
  options.target = config_.attack_target;
  options.true_class = config_.true_class;
  options.victims = config_.victims;
  options.views = config_.evaluate_views;
  options.view_distribution = config_.evaluate_distribution;
  options.size = config_.evaluate_size;
  options.background = config_.evaluate_background;
  options.seed = config_.seed;
  options.device = device_;
  options.renderer.samples = config_.evaluate_samples;
  options.geometry = config_.evaluate_geometry != 0;
  write_record(evaluate_asset(options, progress), folder_ / "eval" / "builtin.json");
}

}  // namespace tt3d
