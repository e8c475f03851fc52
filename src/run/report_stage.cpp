#include <ATen/ATen.h>

#include <algorithm>

#include "tt3d/image.h"
#include "tt3d/json.h"
#include "tt3d/run.h"

/// Stage report: collects the records of a run for its page.
namespace tt3d::run {
namespace fs = std::filesystem;

namespace {

/// The contact sheet: the first views of the evaluation, rendered again, with the recorded answers.
std::vector<report::ShownView> sheet_views(const asset::TexturedMesh& clean,
                                           const asset::TexturedMesh& adversarial,
                                           const record::EvaluationRecord& evaluation,
                                           const scene::ViewFrame& frame) {
  constexpr int64_t kSheet = 12;
  constexpr int kSize = 200;
  const evaluate::AssetRenderer clean_renderer(clean), adversarial_renderer(adversarial);
  const auto views = evaluate::evaluation_views(
      parse_enum<scene::ViewDistribution>(evaluation.views.distribution), evaluation.views.seed,
      std::min(kSheet, evaluation.views.count), kSize, frame);
  const auto picture = [&](const evaluate::AssetRenderer& renderer, const scene::Camera& camera) {
    return image::to_uint8(
        image::over_background(renderer.render({camera})[0], at::ones({3})).contiguous());
  };
  std::vector<report::ShownView> out;
  for (size_t i = 0; i < views.size(); ++i) {
    report::ShownView view;
    view.adversarial = picture(adversarial_renderer, views[i].camera);
    view.clean = picture(clean_renderer, views[i].camera);
    view.azimuth_deg = views[i].azimuth_deg;
    view.elevation_deg = views[i].elevation_deg;
    for (const record::VictimRecord& victim : evaluation.victims) {
      if (i >= victim.answers.size()) continue;
      const record::ViewAnswer& a = victim.answers[i];
      view.answers.push_back({victim.name, a.top1_name, a.p_top1,
                              a.top1 == victim.target.value_or(evaluation.target).index});
    }
    out.push_back(std::move(view));
  }
  return out;
}

std::string title_of(const record::EvaluationRecord& evaluation) {
  const std::string object = evaluation.true_class ? evaluation.true_class->name : "object";
  return object + " taken for " + evaluation.target.name;
}

}  // namespace

report::ShownVideo load_video(const fs::path& json_path, const record::VideoRecord& record) {
  report::ShownVideo video{record, {}};
  fs::path folder = json_path;
  folder.replace_extension(".frames");
  if (!fs::is_directory(folder) || !record.strip) return video;
  for (const record::StripFrame& f : *record.strip) {
    // Take the file name only, so that a record cannot name a file in another folder.
    const fs::path picture = folder / fs::path(f.picture).filename();
    video.frames.push_back({image::read_image(picture).narrow(2, 0, 3).contiguous(), f.seconds,
                            f.background, f.answers});
  }
  return video;
}

void Run::run_report(Progress& progress) {
  progress.begin("report", 1, 0);
  report::ReportInput input;
  const fs::path asset = folder_ / "asset" / "adversarial.glb";
  input.clean = &assets_.load(folder_ / "asset" / "clean.glb");
  input.adversarial = &assets_.load(asset);
  input.evaluation = record::load_evaluation(folder_ / "eval" / "builtin.json");
  input.title = title_of(*input.evaluation);
  record::Records records = record::load_records(folder_ / "eval", "builtin.json");
  input.others = std::move(records.evaluations);
  input.judges = std::move(records.judges);
  for (const auto& [path, video] : records.videos) input.videos.push_back(load_video(path, video));
  input.curves = record::load_curves(folder_ / "attack" / "curves.csv");
  input.config_toml = config_toml(config_);
  input.run = record();
  if (!from_asset()) {
    input.field = read_json_as<record::FieldMetrics>(folder_ / "field" / "metrics.json");
  }
  input.mesh = read_json_as<record::MeshMetrics>(folder_ / "mesh" / "metrics.json");
  input.views = sheet_views(*input.clean, *input.adversarial, *input.evaluation,
                            asset::view_frame(*input.adversarial, asset));
  report::write_report(input, folder_ / "report.html");
  progress.update(1, {});
  progress.end();
}

}  // namespace tt3d::run
