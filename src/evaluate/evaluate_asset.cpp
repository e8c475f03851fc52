#include <ATen/ATen.h>
#include <ATen/core/grad_mode.h>

#include <algorithm>
#include <memory>
#include <optional>

#include "naturalness.h"
#include "tt3d/evaluate.h"
#include "tt3d/image.h"
#include "tt3d/version.h"

namespace tt3d::evaluate {

using at::Tensor;

namespace {

/// Views come from a stream that training does not use.
constexpr uint64_t kHeldOut = 0x5EED0FEA1ULL;
constexpr int64_t kBatch = 10;

/// A victim, with the indices of target and true class in its own labels.
struct LoadedVictim {
  std::shared_ptr<model::Classifier> model;
  record::ClassId target;
  std::optional<record::ClassId> true_class;
  [[nodiscard]] std::optional<int64_t> true_index() const {
    return true_class ? std::optional(true_class->index) : std::nullopt;
  }
};

std::vector<const model::ModelCard*> cards_of(const std::vector<LoadedVictim>& victims) {
  std::vector<const model::ModelCard*> cards;
  cards.reserve(victims.size());
  for (const LoadedVictim& v : victims) cards.push_back(&v.model->card());
  return cards;
}

std::vector<std::shared_ptr<const model::Classifier>> models_of(
    const std::vector<LoadedVictim>& victims) {
  std::vector<std::shared_ptr<const model::Classifier>> models;
  models.reserve(victims.size());
  for (const LoadedVictim& v : victims) models.push_back(v.model);
  return models;
}

std::vector<LoadedVictim> load_victims(const EvaluateOptions& options, Progress& progress) {
  std::vector<LoadedVictim> victims;
  for (const std::string& name : options.victims) {
    LoadedVictim victim;
    victim.model = model::Classifier::load(name, {}, &progress);
    victim.target = model::find_class(options.target, victim.model->card());
    if (!options.true_class.empty()) {
      victim.true_class = model::find_class(options.true_class, victim.model->card());
    }
    victims.push_back(std::move(victim));
  }
  model::check_same_class(options.target, cards_of(victims), "target");
  model::check_same_class(options.true_class, cards_of(victims), "true class");
  return victims;
}

void check_options(const EvaluateOptions& options) {
  if (options.victims.empty()) throw InputError("evaluate.victims: name at least one model");
  if (options.views < 1) throw InputError("evaluate.views: expected at least 1");
  check_renderer(options.renderer);
  if ((options.geometry || options.measures_lpips()) && options.clean.empty()) {
    throw InputError(
        "LPIPS and geometry compare with the clean object: give its file with --clean");
  }
}

/// The record without measurements.
record::EvaluationRecord begin_record(const EvaluateOptions& options,
                                      const std::vector<LoadedVictim>& victims) {
  record::EvaluationRecord record;
  record.asset = options.asset.string();
  record.asset_sha256 = sha256_file(options.asset);
  record.target = victims.front().target;
  record.true_class = victims.front().true_class;
  record.renderer = {name_of(options.renderer.name), std::nullopt, options.renderer.lit,
                     samples_of(options.renderer)};
  record.background = options.background;
  record.views = {name_of(options.view_distribution), options.views, options.seed, options.size};
  record.tt3d_version = kVersion;
  for (const LoadedVictim& v : victims) {
    record::VictimRecord victim;
    victim.name = v.model->card().name;
    victim.sha256 = v.model->card().sha256;
    victim.target = v.target;
    victim.true_class = v.true_class;
    record.victims.push_back(victim);
  }
  return record;
}

/// The pictures of an evaluation: the adversarial object and, if given, the clean object.
class Pictures {
 public:
  Pictures(const EvaluateOptions& options, asset::AssetFiles& assets,
           const std::vector<scene::SampledView>& views, Progress& progress)
      : options_(options),
        backgrounds_(options.background),
        views_(views),
        adversarial_(options.asset, assets.load(options.asset), views, options.renderer,
                     options.device, progress) {
    if (options.clean.empty()) return;
    clean_.emplace(options.clean, assets.load(options.clean, &progress), views, options.renderer,
                   options.device, progress);
    comparison_ = std::make_unique<PictureComparison>(options, assets.load(options.asset));
  }

  [[nodiscard]] const std::string& version() const { return adversarial_.version(); }

  /// Views [begin,end) of the adversarial object, and of the clean object if given.
  std::pair<Tensor, Tensor> next(int64_t begin, int64_t end) {
    const Tensor pictures = pictures_over(adversarial_, backgrounds_, begin, end, options_.seed);
    if (!clean_) return {pictures, Tensor()};
    const Tensor clean = pictures_over(*clean_, backgrounds_, begin, end, options_.seed);
    for (int64_t i = begin; i < end; ++i) {
      comparison_->add(pictures[i - begin].permute({1, 2, 0}), clean[i - begin].permute({1, 2, 0}),
                       views_[static_cast<size_t>(i)].camera);
    }
    return {pictures, clean};
  }

  [[nodiscard]] record::NaturalnessRecord naturalness(Progress& progress) const {
    return comparison_ ? comparison_->finish(progress) : record::NaturalnessRecord{};
  }

 private:
  const EvaluateOptions& options_;
  scene::Backgrounds backgrounds_;
  const std::vector<scene::SampledView>& views_;
  AssetViews adversarial_;
  std::optional<AssetViews> clean_;
  std::unique_ptr<PictureComparison> comparison_;
};

}  // namespace

Tensor pictures_over(const AssetViews& views, const scene::Backgrounds& background, int64_t begin,
                     int64_t end, uint64_t seed) {
  const Tensor rendered = views.render(begin, end);
  std::vector<Tensor> behind;
  for (int64_t i = begin; i < end; ++i) {
    Random random(seed, "evaluate/background", static_cast<uint64_t>(i));
    behind.push_back(background.draw(rendered.size(1), rendered.size(2), random));
  }
  const Tensor rgb =
      image::over_background(rendered, at::stack(behind).to(rendered.device())).clamp(0, 1);
  return (rgb * 255).round().div(255).permute({0, 3, 1, 2}).contiguous();
}

void answer(const model::Classifier& model, const Tensor& pictures, const Tensor& clean,
            int64_t target, std::optional<int64_t> true_class,
            std::vector<record::ViewAnswer>& answers) {
  const Tensor p =
      model::probabilities(model, model.logits(model::preprocess(pictures, model.card()))).cpu();
  const auto [best, index] = p.max(1);
  Tensor clean_index;
  if (clean.defined()) {
    clean_index = model.logits(model::preprocess(clean, model.card())).argmax(1).cpu();
  }
  for (int64_t i = 0; i < p.size(0); ++i) {
    record::ViewAnswer a;
    a.top1 = index[i].item<int64_t>();
    a.top1_name = model.card().labels[static_cast<size_t>(a.top1)];
    a.p_top1 = best[i].item<double>();
    a.p_target = p[i][target].item<double>();
    if (true_class) a.p_true = p[i][*true_class].item<double>();
    if (clean.defined()) a.clean_top1 = clean_index[i].item<int64_t>();
    answers.push_back(a);
  }
}

std::vector<scene::SampledView> evaluation_views(scene::ViewDistribution distribution,
                                                 uint64_t seed, int64_t count, int size,
                                                 const scene::ViewFrame& frame) {
  return scene::sample_views(distribution, seed ^ kHeldOut, 0, count, size, frame);
}

record::EvaluationRecord evaluate_asset(const EvaluateOptions& options, asset::AssetFiles& assets,
                                        Progress& progress) {
  at::NoGradGuard guard;
  const double start = now_seconds();
  check_options(options);
  const asset::TexturedMesh& asset = assets.load(options.asset, &progress);
  const std::vector<LoadedVictim> victims = load_victims(options, progress);
  record::EvaluationRecord record = begin_record(options, victims);
  const auto views = evaluation_views(options.view_distribution, options.seed, options.views,
                                      options.size, asset::view_frame(asset, options.asset));
  for (const scene::SampledView& v : views) {
    record.poses.push_back({v.azimuth_deg, v.elevation_deg, v.distance, v.roll_deg});
  }
  const model::WeightsGuard weights(models_of(victims));
  Pictures source(options, assets, views, progress);
  record.renderer.version = source.version();
  progress.begin("evaluate", options.views, 0);
  for (int64_t begin = 0; begin < options.views; begin += kBatch) {
    const int64_t end = std::min(options.views, begin + kBatch);
    const auto [pictures, clean] = source.next(begin, end);
    for (size_t m = 0; m < victims.size(); ++m) {
      answer(*victims[m].model, pictures, clean, victims[m].target.index, victims[m].true_index(),
             record.victims[m].answers);
    }
    progress.update(end, {});
    progress.check();
  }
  progress.end();
  weights.check();
  for (size_t m = 0; m < victims.size(); ++m) {
    record::summarize(record.victims[m], victims[m].target.index, victims[m].true_index());
  }
  record.naturalness = source.naturalness(progress);
  if (options.geometry) {
    record.geometry = compare_geometry(assets.load(options.clean), asset,
                                       options.geometry_time_limit_seconds, progress);
  }
  record.wall_seconds = now_seconds() - start;
  return record;
}

}  // namespace tt3d::evaluate
