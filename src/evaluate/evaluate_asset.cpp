#include <ATen/ATen.h>
#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "naturalness.h"
#include "tt3d/evaluate.h"
#include "tt3d/field.h"
#include "tt3d/version.h"

namespace tt3d {
namespace {

using at::Tensor;
using nlohmann::json;

/// Held out from every training stream by its name.
constexpr uint64_t kHeldOut = 0x5EED0FEA1ULL;
constexpr int64_t kBatch = 10;

/// Pictures of a batch of views over their backgrounds: [N,3,H,W] in [0,1].
Tensor pictures_of(const AssetViews& views, const Backgrounds& backgrounds, int64_t begin,
                   int64_t end, uint64_t seed) {
  const Tensor rendered = views.render(begin, end);
  std::vector<Tensor> behind;
  for (int64_t i = begin; i < end; ++i) {
    Random random(seed, "evaluate/background", static_cast<uint64_t>(i));
    behind.push_back(backgrounds.draw(rendered.size(1), rendered.size(2), random));
  }
  const Tensor rgb = over_background(rendered, at::stack(behind).to(rendered.device())).clamp(0, 1);
  // What is scored is what a PNG of it would hold.
  return (rgb * 255).round().div(255).permute({0, 3, 1, 2}).contiguous();
}

json optional_number(const std::optional<double>& x) { return x ? json(*x) : json(nullptr); }

json geometry_json(const std::optional<GeometryRecord>& g) {
  if (!g) return nullptr;
  return {{"chamfer", g->chamfer},
          {"hausdorff", g->hausdorff},
          {"normal_deviation_deg", g->normal_deviation_deg},
          {"self_intersecting_faces", g->self_intersecting_faces},
          {"self_intersecting_faces_clean", g->self_intersecting_faces_clean}};
}

json class_json(const ClassId& c) {
  if (c.index < 0) return nullptr;
  return {{"index", c.index}, {"wnid", c.wnid}, {"name", c.name}};
}

std::string csv_text(const std::string& text) {
  if (text.find_first_of(",\"\n") == std::string::npos) return text;
  std::string quoted = "\"";
  for (const char c : text) quoted += c == '"' ? std::string("\"\"") : std::string(1, c);
  return quoted + "\"";
}

}  // namespace

void answer(const Classifier& model, const Tensor& pictures, const Tensor& clean, int64_t target,
            int64_t true_class, std::vector<ViewAnswer>& answers) {
  const Tensor p = model.logits(preprocess(pictures, model.card())).softmax(1).cpu();
  const auto [best, index] = p.max(1);
  Tensor clean_index;
  if (clean.defined()) {
    clean_index = model.logits(preprocess(clean, model.card())).argmax(1).cpu();
  }
  for (int64_t i = 0; i < p.size(0); ++i) {
    ViewAnswer a;
    a.top1 = index[i].item<int64_t>();
    a.top1_name = model.card().labels[a.top1];
    a.p_top1 = best[i].item<double>();
    a.p_target = p[i][target].item<double>();
    if (true_class >= 0) a.p_true = p[i][true_class].item<double>();
    if (clean.defined()) a.clean_top1 = clean_index[i].item<int64_t>();
    answers.push_back(a);
  }
}

void summarize(VictimRecord& v, int64_t target, int64_t true_class, bool has_clean) {
  const auto n = static_cast<int64_t>(v.answers.size());
  int64_t hits = 0, correct = 0, hits_on_correct = 0;
  double probability = 0;
  for (const ViewAnswer& a : v.answers) {
    const bool hit = a.top1 == target;
    hits += hit;
    probability += a.p_target;
    if (has_clean && true_class >= 0 && a.clean_top1 == true_class) {
      ++correct;
      hits_on_correct += hit;
    }
  }
  v.asr = static_cast<double>(hits) / static_cast<double>(n);
  v.asr_ci95 = wilson_interval(hits, n);
  v.mean_target_probability = probability / static_cast<double>(n);
  if (!has_clean || true_class < 0) return;
  v.clean_n = n;
  v.clean_accuracy = static_cast<double>(correct) / static_cast<double>(n);
  v.asr_on_correct_n = correct;
  if (correct > 0) {
    v.asr_on_correct = static_cast<double>(hits_on_correct) / static_cast<double>(correct);
  }
}

std::vector<SampledView> evaluation_views(const std::string& distribution, uint64_t seed,
                                          int64_t count, int size, const ViewFrame& frame) {
  return sample_views(distribution, seed ^ kHeldOut, 0, count, size, frame);
}

EvalRecord evaluate_asset(const EvaluateOptions& options, Progress& progress) {
  at::NoGradGuard guard;
  const double start = now_seconds();
  if (options.victims.empty()) throw InputError("evaluate.victims: name at least one model");
  if (options.views < 1) throw InputError("evaluate.views: expected at least 1");
  check_renderer(options.renderer);
  if ((options.geometry || !options.lpips.empty()) && options.clean.empty()) {
    throw InputError("LPIPS and geometry compare with the clean object; name it with --clean");
  }
  EvalRecord record;
  record.options = options;
  record.asset_sha256 = sha256_file(options.asset);
  const TexturedMesh asset = load_asset(options.asset);
  const Backgrounds backgrounds(options.background);
  const bool has_clean = !options.clean.empty();
  std::vector<std::shared_ptr<Classifier>> models;
  std::vector<int64_t> targets, trues;
  for (const std::string& name : options.victims) {
    models.push_back(Classifier::load(name, {}, &progress));
    record.target = find_class(options.target, models.back()->card());
    targets.push_back(record.target.index);
    if (!options.true_class.empty()) {
      record.true_class = find_class(options.true_class, models.back()->card());
    }
    trues.push_back(record.true_class.index);
    VictimRecord victim;
    victim.name = models.back()->card().name;
    victim.sha256 = models.back()->card().sha256;
    record.victims.push_back(victim);
  }
  record.views = evaluation_views(options.view_distribution, options.seed, options.views,
                                  options.size, asset_view_frame(asset, options.asset));
  const AssetViews pictures_source(options.asset, asset, record.views, options.renderer,
                                   options.device, progress);
  record.renderer_version = pictures_source.version();
  std::optional<AssetViews> clean_source;
  std::optional<TexturedMesh> clean_mesh;
  if (has_clean) {
    clean_mesh = load_asset(options.clean);
    clean_source.emplace(options.clean, *clean_mesh, record.views, options.renderer, options.device,
                         progress);
  }
  Naturalness naturalness(options, asset);
  progress.begin("evaluate", options.views, 0);
  for (int64_t begin = 0; begin < options.views; begin += kBatch) {
    const int64_t end = std::min(options.views, begin + kBatch);
    const Tensor pictures = pictures_of(pictures_source, backgrounds, begin, end, options.seed);
    Tensor clean;
    if (has_clean) {
      clean = pictures_of(*clean_source, backgrounds, begin, end, options.seed);
      for (int64_t i = begin; i < end; ++i) {
        naturalness.add(pictures[i - begin].permute({1, 2, 0}), clean[i - begin].permute({1, 2, 0}),
                        record.views[i].camera);
      }
    }
    for (size_t m = 0; m < models.size(); ++m) {
      answer(*models[m], pictures, clean, targets[m], trues[m], record.victims[m].answers);
    }
    progress.update(end, {});
    progress.check();
  }
  progress.end();
  for (size_t m = 0; m < models.size(); ++m) {
    summarize(record.victims[m], targets[m], trues[m], has_clean);
  }
  if (has_clean) {
    naturalness.finish(record, progress);
    if (options.geometry) {
      record.geometry =
          compare_geometry(*clean_mesh, asset, options.geometry_time_limit_seconds, progress);
    }
  }
  record.wall_seconds = now_seconds() - start;
  return record;
}

std::string record_json(const EvalRecord& r) {
  json victims = json::array();
  for (const VictimRecord& v : r.victims) {
    victims.push_back({{"name", v.name},
                       {"sha256", v.sha256},
                       {"clean_accuracy", optional_number(v.clean_accuracy)},
                       {"clean_n", v.clean_n},
                       {"asr", v.asr},
                       {"asr_ci95", {v.asr_ci95.low, v.asr_ci95.high}},
                       {"asr_on_correct", optional_number(v.asr_on_correct)},
                       {"asr_on_correct_n", v.asr_on_correct_n},
                       {"mean_target_probability", v.mean_target_probability}});
  }
  const json j = {{"asset", r.options.asset.string()},
                  {"asset_sha256", r.asset_sha256},
                  {"target", class_json(r.target)},
                  {"true_class", class_json(r.true_class)},
                  {"renderer",
                   {{"name", r.options.renderer.name},
                    {"version", r.renderer_version},
                    {"lit", r.options.renderer.lit},
                    {"samples", samples_of(r.options.renderer)}}},
                  {"background", r.options.background},
                  {"views",
                   {{"distribution", r.options.view_distribution},
                    {"count", r.options.views},
                    {"seed", r.options.seed},
                    {"size", r.options.size}}},
                  {"victims", victims},
                  {"naturalness",
                   {{"psnr", optional_number(r.psnr)},
                    {"ssim", optional_number(r.ssim)},
                    {"lpips", optional_number(r.lpips)},
                    {"lpips_net", r.options.lpips},
                    {"psnr_box", optional_number(r.psnr_box)},
                    {"ssim_box", optional_number(r.ssim_box)},
                    {"lpips_box", optional_number(r.lpips_box)}}},
                  {"geometry", geometry_json(r.geometry)},
                  {"tt3d_version", kVersion},
                  {"wall_seconds", r.wall_seconds}};
  return j.dump(1) + "\n";
}

std::string record_csv(const EvalRecord& r) {
  std::string text =
      "victim,view,azimuth_deg,elevation_deg,distance,roll_deg,top1_index,top1_name,p_top1,"
      "p_target,p_true,clean_top1_index\n";
  for (const VictimRecord& v : r.victims) {
    for (size_t i = 0; i < v.answers.size(); ++i) {
      const SampledView& view = r.views[i];
      const ViewAnswer& a = v.answers[i];
      text += fmt::format("{},{},{:.4f},{:.4f},{:.6g},{:.4f},{},{},{:.6f},{:.6f},{},{}\n",
                          csv_text(v.name), i, view.azimuth_deg, view.elevation_deg, view.distance,
                          view.roll_deg, a.top1, csv_text(a.top1_name), a.p_top1, a.p_target,
                          r.true_class.index >= 0 ? fmt::format("{:.6f}", a.p_true) : "",
                          a.clean_top1 >= 0 ? std::to_string(a.clean_top1) : "");
    }
  }
  return text;
}

void write_record(const EvalRecord& record, const std::filesystem::path& json_path) {
  auto csv_path = json_path;
  write_file_atomic(csv_path.replace_extension(".csv"), record_csv(record));
  write_file_atomic(json_path, record_json(record));
}

void render_to_folder(const std::filesystem::path& asset_path, const std::string& distribution,
                      int64_t count, int size, uint64_t seed, const std::filesystem::path& out,
                      Progress& progress, at::Device device, const RendererChoice& renderer) {
  const TexturedMesh asset = load_asset(asset_path);
  const auto views =
      evaluation_views(distribution, seed, count, size, asset_view_frame(asset, asset_path));
  const AssetViews pictures(asset_path, asset, views, renderer, device, progress);
  json frames = json::array();
  progress.begin("render", count, 0);
  for (int64_t i = 0; i < count; ++i) {
    const SampledView& view = views[i];
    const Tensor rgba = pictures.render(i, i + 1)[0].clamp(0, 1).cpu();
    const Tensor alpha = rgba.narrow(2, 3, 1);
    const Tensor straight = at::cat({rgba.narrow(2, 0, 3) / alpha.clamp_min(1e-6), alpha}, 2);
    const std::string name = fmt::format("r_{}", i);
    write_file_atomic(out / "test" / (name + ".png"), encode_png(to_uint8(straight)));
    json matrix = json::array();
    for (int row = 0; row < 4; ++row) {
      json line = json::array();
      for (int k = 0; k < 4; ++k) line.push_back(view.camera.camera_to_world[4 * row + k]);
      matrix.push_back(line);
    }
    frames.push_back({{"file_path", "./test/" + name},
                      {"azimuth_deg", view.azimuth_deg},
                      {"elevation_deg", view.elevation_deg},
                      {"distance", view.distance},
                      {"roll_deg", view.roll_deg},
                      {"transform_matrix", matrix}});
    progress.update(i + 1, {});
    progress.check();
  }
  progress.end();
  const Camera& camera = views[0].camera;
  const json transforms = {{"camera_angle_x", 2 * std::atan(0.5 * camera.width / camera.fx)},
                           {"frames", frames}};
  // Readers of the format want a training split: both name the same pictures.
  for (const char* split : {"transforms_train.json", "transforms_test.json", "transforms.json"}) {
    write_file_atomic(out / split, transforms.dump(1) + "\n");
  }
}

}  // namespace tt3d
