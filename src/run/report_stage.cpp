#include <ATen/ATen.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <sstream>

#include "tt3d/bake.h"
#include "tt3d/report.h"
#include "tt3d/run.h"

namespace tt3d {
namespace fs = std::filesystem;
using nlohmann::json;

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
