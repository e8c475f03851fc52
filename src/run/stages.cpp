#include <ATen/ATen.h>

#include "run_files.h"
#include "tt3d/json.h"
#include "tt3d/run.h"

/// Stages attack, bake and evaluate.
namespace tt3d::run {
namespace fs = std::filesystem;
using at::Tensor;

namespace {

/// The UV map, in the folder of the stage that made it.
constexpr const char* kMap = "uv_map.safetensors";

/// The options and the mesh that a map was made with. A map of another mesh does not fit.
std::vector<int64_t> cut_of(const scene::TriMesh& mesh, const asset::BakeOptions& bake) {
  const Tensor vertices = mesh.vertices.contiguous(), faces = mesh.faces.contiguous();
  const std::string digest =
      sha256(std::string_view(static_cast<const char*>(vertices.const_data_ptr()),
                              vertices.nbytes())) +
      sha256(std::string_view(static_cast<const char*>(faces.const_data_ptr()), faces.nbytes()));
  return {bake.resolution, bake.padding, static_cast<int64_t>(hash_name(digest))};
}

/// The colours of an appearance at the texels of a map: [size,size,3] uint8.
Tensor bake_appearance(const scene::UvMap& map, int64_t size, const scene::TriMesh& rest,
                       const object::Appearance& appearance, at::Device device) {
  const auto there = appearance.to(device);
  return asset::bake_texture(map, size, rest, [&](const raster::SurfacePoints& p) {
    return there->color({p.positions.to(device), p.rast.to(device)}).cpu();
  });
}

}  // namespace

scene::UvMap Run::uv_map(const scene::TriMesh& mesh, const fs::path& stage_folder) const {
  const asset::BakeOptions& bake = config_.bake;
  const std::vector<int64_t> cut = cut_of(mesh, bake);
  const int64_t faces = mesh.faces.size(0);
  for (const char* folder : {"attack", "asset"}) {
    if (auto map = object::load_map(folder_ / folder / kMap, faces, cut)) return *map;
  }
  const scene::UvMap map = asset::unwrap(mesh.vertices, mesh.faces, bake.resolution, bake.padding,
                                         bake.unwrap_time_limit);
  object::save_map(map, cut, stage_folder / kMap);
  return map;
}

// ---- attack -------------------------------------------------------------------------------

attack::AttackInput Run::attack_input(Progress& progress) {
  const fs::path folder = folder_ / "attack";
  const attack::AttackOptions& options = config_.attack.options;
  object::Object clean = clean_object();
  attack::AttackInput input;
  if (attack::needs_uv_map(options)) {
    clean.map = uv_map(clean.mesh, folder);
    input.texels = bake_appearance(*clean.map, options.tile.texture_size, clean.mesh,
                                   *clean.appearance, device_)
                       .to(device_);
  }
  input.object = clean.to(device_);
  input.frame = placement(progress).frame;
  if (from_asset() && attack::needs_grid_mlp(options)) {
    constexpr int64_t kSteps = 300;
    input.object.appearance = object::fit_grid_mlp(
        *input.object.appearance, input.object.mesh, config_.field.shape, config_.seed, kSteps,
        folder / "appearance_checkpoint.safetensors", progress);
  }
  return input;
}

void Run::load_surrogates(attack::AttackInput& input, Progress& progress) {
  const std::string wanted = class_of_objective(config_);
  std::vector<const model::ModelCard*> cards;
  for (const std::string& name : config_.attack.surrogates) {
    const auto model = model::Classifier::load(name, {}, &progress);
    if (model->scores() == model::Scores::kNone) {
      throw InputError(model->path(),
                       "gives probabilities ('scores' is none), but a surrogate needs logits; "
                       "export it without its last layer");
    }
    cards.push_back(&model->card());
    model->check_gradients();
    input.classes.push_back(model::find_class(wanted, model->card()).index);
    // Loading has compared the file with its card.
    hashes_[fs::absolute(model->path()).string()] = model->card().sha256;
    add_inputs({model->path()});
    input.surrogates.push_back(model);
  }
  model::check_same_class(wanted, cards, "the class of the objective");
}

std::vector<Run> Run::other_runs(attack::AttackInput& input, Progress& progress) {
  std::vector<Run> others;
  for (const std::string& name : config_.attack.also) {
    others.push_back(Run::open(name));
    Run& other = others.back();
    if (!fs::exists(other.folder_ / "mesh" / "mesh.safetensors")) {
      throw InputError(name, "has no mesh yet; create it with 'tt3d mesh'");
    }
    other.use_device(device_);
    input.also.push_back(other.attack_input(progress));
    input.also.back().surrogates = input.surrogates;
    input.also.back().classes = input.classes;
  }
  return others;
}

void Run::run_attack(Progress& progress) {
  (void)class_of_objective(config_);  // reject a missing class before the long work
  attack::AttackInput input = attack_input(progress);
  load_surrogates(input, progress);
  std::vector<Run> others = other_runs(input, progress);
  const attack::AttackResult result = attack::run_attack(
      input, config_.attack.options, config_.seed, folder_ / "attack" / kCheckpoint, progress);
  save_attack_files(result);
  for (size_t i = 0; i < others.size(); ++i) {
    others[i].adopt_attack(*this, attack::apply_appearance(result, input.also[i]));
  }
  fs::remove(folder_ / "attack" / "appearance_checkpoint.safetensors");
}

void Run::save_attack_files(const attack::AttackResult& result) const {
  const fs::path folder = folder_ / "attack";
  attack::save_attack(result, folder / "attack.safetensors");
  write_file_atomic(folder / "curves.csv", record::curves_csv(result.curves));
  if (!result.epochs.empty()) {
    write_file_atomic(folder / "epochs.csv", record::epochs_csv(result.epochs));
  }
}

void Run::adopt_attack(const Run& from, const attack::AttackResult& result) {
  RunConfig theirs = from.config_;
  std::vector<Assignment> assignments;
  const KeyList keys = keys_of(theirs);
  for (const Key& key : keys.all()) {
    const bool of_attack = key.name.starts_with("attack.") && key.name != "attack.also";
    if (of_attack) assignments.push_back({key.name, key.get()});
  }
  reconfigure(assignments, "attack");
  save_attack_files(result);
  enter({"attack", 0, 0, from.config_.seed, {}});
  save();
}

// ---- bake ---------------------------------------------------------------------------------

void Run::write_asset(const std::string& name, const scene::TriMesh& mesh,
                      const object::Appearance& appearance, const scene::UvMap& map,
                      const scene::TriMesh& rest, const scene::Normalization& normalization) {
  const fs::path folder = folder_ / "asset";
  const int size = config_.bake.resolution;
  asset::TexturedMesh asset;
  asset.origin = origin_of(normalization);
  asset.vertices = relative_to(asset.origin, normalization).to_world(mesh.vertices);
  asset.faces = mesh.faces;
  asset.map = map;
  // Colours are looked up on the rest surface, which is the clean mesh.
  asset.texture = bake_appearance(map, size, rest, appearance, device_);
  assets_.forget(folder / (name + ".glb"));
  asset::write_glb(asset, folder / (name + ".glb"));
  asset::write_obj(asset, folder / (name + ".obj"));
}

void Run::bake_clean(Progress& progress) {
  run_until("mesh", progress);
  const fs::path folder = folder_ / "asset";
  const scene::Placement placed = placement(progress);
  const scene::Normalization& n = placed.normalization;
  const object::Object clean = clean_object();
  const scene::UvMap map = uv_map(clean.mesh, folder);
  asset::write_view_frame(n.to_world(placed.frame), folder);
  write_asset("clean", clean.mesh, *clean.appearance, map, clean.mesh, n);
}

void Run::run_bake(Progress& progress) {
  const fs::path folder = folder_ / "asset";
  const scene::Placement placed = placement(progress);
  const scene::Normalization& n = placed.normalization;
  const object::Object clean = clean_object();
  const object::Object adversarial = object::load_object(folder_ / "attack" / "attack.safetensors");
  progress.begin("bake", 3, 0);
  const scene::UvMap map = uv_map(clean.mesh, folder);
  progress.update(1, {});
  progress.check();
  asset::write_view_frame(n.to_world(placed.frame), folder);
  write_asset("clean", clean.mesh, *clean.appearance, map, clean.mesh, n);
  progress.update(2, {});
  progress.check();
  write_asset("adversarial", adversarial.mesh, *adversarial.appearance, map, clean.mesh, n);
  progress.update(3, {});
  progress.end();
  if (from_asset()) return;  // no photographs to compare with
  const asset::TexturedMesh& written = assets_.load(folder / "clean.glb");
  const scene::Normalization relative = relative_to(written.origin, n);
  const evaluate::AssetRenderer renderer(written, device_);
  const double psnr = capture::mean_psnr(
      photographs(progress).test,
      [&](const scene::Camera& camera) { return renderer.render({relative.to_world(camera)})[0]; },
      progress);
  write_json(folder / "metrics.json", to_json(record::AssetMetrics{psnr}));
}

// ---- evaluate -----------------------------------------------------------------------------

void Run::run_evaluate(Progress& progress) {
  evaluate::EvaluateOptions options = config_.evaluate;
  options.asset = folder_ / "asset" / "adversarial.glb";
  options.clean = folder_ / "asset" / "clean.glb";
  options.target = config_.attack.target;
  options.seed = config_.seed;
  options.device = device_;
  for (const std::string& name : options.victims) add_inputs({model::find_model(name)});
  record::save(evaluate::evaluate_asset(options, assets_, progress),
               folder_ / "eval" / "builtin.json");
}

}  // namespace tt3d::run
