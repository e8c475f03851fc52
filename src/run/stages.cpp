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

namespace {

/// Rows of eval/builtin.csv by victim and view.
struct CsvRow {
  std::string victim, top1_name;
  int64_t view, top1;
  double azimuth, elevation, p_top1;
};

/// Splits a CSV line, quotes respected.
std::vector<std::string> csv_fields(const std::string& line) {
  std::vector<std::string> fields(1);
  bool quotes = false;
  for (const char c : line) {
    if (c == '"')
      quotes = !quotes;
    else if (c == ',' && !quotes)
      fields.emplace_back();
    else
      fields.back() += c;
  }
  return fields;
}

std::vector<CsvRow> read_rows(const fs::path& path) {
  std::istringstream in(read_file(path));
  std::vector<CsvRow> rows;
  std::string line;
  std::getline(in, line);
  for (long number = 2; std::getline(in, line); ++number) {
    try {
      const auto f = csv_fields(line);
      rows.push_back({f.at(0), f.at(7), std::stoll(f.at(1)), std::stoll(f.at(6)),
                      std::stod(f.at(2)), std::stod(f.at(3)), std::stod(f.at(8))});
    } catch (const std::logic_error&) {  // too few fields, or no number
      throw InputError(path, number, "expected a row as 'tt3d evaluate' writes it");
    }
  }
  return rows;
}

/// The run's own evaluation, the text of `path`, with all that the report reads of it.
json parse_own_record(const std::string& text, const fs::path& path) {
  try {
    json j = json::parse(text);
    (void)j.at("target").at("name").get<std::string>();
    (void)j.at("target").at("index").get<int64_t>();
    if (!j.at("true_class").is_null()) (void)j.at("true_class").at("name").get<std::string>();
    const json& views = j.at("views");
    (void)views.at("distribution").get<std::string>();
    (void)views.at("seed").get<uint64_t>();
    (void)views.at("count").get<int64_t>();
    return j;
  } catch (const json::exception& error) {
    throw InputError(path, std::string("is not an evaluation record: ") + error.what());
  }
}

/// The contact sheet: the first views of the evaluation, drawn again, with the recorded answers.
std::vector<ReportView> report_views(const fs::path& run, const json& record, int64_t count) {
  const fs::path clean_path = run / "asset" / "clean.glb";
  const TexturedMesh clean = load_asset(clean_path),
                     adversarial = load_asset(run / "asset" / "adversarial.glb");
  const AssetRenderer clean_renderer(clean), adversarial_renderer(adversarial);
  const auto rows = read_rows(run / "eval" / "builtin.csv");
  const auto views =
      evaluation_views(record["views"]["distribution"], record["views"]["seed"], count, 200,
                       asset_view_frame(adversarial, run / "asset" / "adversarial.glb"));
  std::vector<ReportView> out;
  const auto picture = [&](const AssetRenderer& renderer, const Camera& camera) {
    return to_uint8(over_background(renderer.render({camera})[0], at::ones({3})).contiguous());
  };
  for (int64_t i = 0; i < count; ++i) {
    ReportView view;
    view.adversarial = picture(adversarial_renderer, views[i].camera);
    view.clean = picture(clean_renderer, views[i].camera);
    view.azimuth_deg = views[i].azimuth_deg;
    view.elevation_deg = views[i].elevation_deg;
    for (const CsvRow& row : rows) {
      if (row.view != i) continue;
      view.answers.push_back({row.victim, row.top1_name, row.p_top1,
                              row.top1 == record["target"]["index"].get<int64_t>()});
    }
    out.push_back(std::move(view));
  }
  return out;
}

}  // namespace

RecordTexts records_in(const fs::path& folder, const std::string& without) {
  std::vector<fs::path> files;
  for (const auto& entry : fs::directory_iterator(folder)) {
    const fs::path& path = entry.path();
    if (path.extension() == ".json" && path.filename() != without) files.push_back(path);
  }
  std::sort(files.begin(), files.end());
  RecordTexts records;
  for (const fs::path& path : files) {
    const std::string text = read_file(path);
    const json j = json::parse(text, nullptr, false);
    if (!j.is_object()) continue;
    if (j.contains("victims") && j.contains("renderer")) records.evaluations.push_back(text);
    if (j.contains("task") && j.contains("shares")) records.judges.push_back(text);
    if (j.contains("victims") && j.contains("video")) records.videos.push_back(path);
  }
  return records;
}

ReportVideo read_video(const fs::path& path) {
  ReportVideo video{read_file(path), {}};
  fs::path folder = path;
  folder.replace_extension(".frames");
  if (!fs::is_directory(folder)) return video;
  try {
    const json record = json::parse(video.record_json);
    for (const json& f : record.value("strip", json::array())) {
      // The name alone: a record leads to no other folder.
      const fs::path picture = folder / fs::path(f.at("picture").get<std::string>()).filename();
      ReportFrame frame{read_image(picture).narrow(2, 0, 3).contiguous(),
                        f.at("seconds"),
                        f.at("background"),
                        {}};
      for (const json& a : f.at("answers")) {
        frame.answers.push_back(
            {a.at("victim"), a.at("answer"), a.at("probability"), a.at("is_target")});
      }
      video.frames.push_back(std::move(frame));
    }
  } catch (const json::exception& error) {
    throw InputError(path, std::string("is not a record of video-score: ") + error.what());
  }
  return video;
}

void Run::run_report(Progress& progress) {
  progress.begin("report", 1, 0);
  ReportInput input;
  const fs::path evaluation = folder_ / "eval" / "builtin.json";
  input.record_json = read_file(evaluation);
  const json record = parse_own_record(input.record_json, evaluation);
  const std::string target = record["target"]["name"];
  const std::string object =
      record["true_class"].is_null() ? "object" : record["true_class"]["name"].get<std::string>();
  input.title = object + " taken for " + target;
  input.clean_glb = folder_ / "asset" / "clean.glb";
  input.adversarial_glb = folder_ / "asset" / "adversarial.glb";
  input.views_csv = read_file(folder_ / "eval" / "builtin.csv");
  RecordTexts others = records_in(folder_ / "eval", "builtin.json");
  input.other_records = std::move(others.evaluations);
  input.judge_records = std::move(others.judges);
  for (const fs::path& video : others.videos) input.videos.push_back(read_video(video));
  input.curves_csv = read_file(folder_ / "attack" / "curves.csv");
  input.config_toml = config_toml(config_);
  save();  // stages so far
  input.run_json = read_file(folder_ / "run.json");
  if (config_.asset.empty()) {  // else there is no field
    input.field_metrics_json = read_file(folder_ / "field" / "metrics.json");
  }
  input.mesh_metrics_json = read_file(folder_ / "mesh" / "metrics.json");
  constexpr int64_t kSheet = 12;
  input.views =
      report_views(folder_, record, std::min(kSheet, record["views"]["count"].get<int64_t>()));
  write_report(input, folder_ / "report.html");
  progress.update(1, {});
  progress.end();
}

}  // namespace tt3d
